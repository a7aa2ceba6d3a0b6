"""State of a playback, and the tolerances with which a start becomes one."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from fmp_drake.errors import SkillError
from fmp_drake.numeric import Array, check_number, shown
from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive

# Variance of the force at a start, as a factor of that of the movement.
_FORCE_VARIANCE = 1e6


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaybackState:
    """Complete state of a playback at one instant; it determines the continuation.

    The weights are those at the last tick: the newest sample of the window at or before
    the instant. All other values are those at the instant.

    Attributes
    ----------
    weights : ndarray, shape (D*T,)
        Fourier weights w at the last tick.
    target : ndarray, shape (D*T,)
        Weights that w relaxes to: a component's mean or a sample of it.
    component : int
        Index j* of the tracked component.
    step : int
        Sample of the window at the last tick, from K - 1 to T - 1.
    history : ndarray, shape (K, D)
        Desired values at the last K ticks, the newest last.
    offset : ndarray, shape (2, D)
        Offset added to the value and the velocity (per second of real time) of the
        weights. It decays in real time, at any tempo.
    blend_time : float
        Time constant of that decay, s.
    time_since_tick : float
        Skill time since the last tick, s.
    tempo : float
        Skill time per real time.
    tempo_rate : float
        Change of the tempo, per second.
    sample : bool
        Whether re-mappings draw samples of a component instead of its mean.
    seed : int
        Seed of these samples.
    remaps : int
        Number of re-mappings so far.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import FourierMovementPrimitive, Player
    >>> windows = np.random.default_rng(0).standard_normal((40, 24, 2))
    >>> skill = FourierMovementPrimitive(n_steps=24, rate=10, overlap=4).fit(windows)
    >>> player = Player(skill)
    >>> state = player.advance(player.start([0.0, 0.0]), 3.27)
    >>> state.step, state.remaps, round(state.time_since_tick, 6)
    (18, 1, 0.07)
    """

    weights: Array
    target: Array
    component: int
    step: int
    history: Array
    offset: Array
    blend_time: float
    time_since_tick: float = 0.0
    tempo: float = 1.0
    tempo_rate: float = 0.0
    sample: bool = False
    seed: int = 0
    remaps: int = 0

    def seconds_until(self, time_since_tick: float) -> float:
        """Return the real time until the skill reaches a time, s.

        Parameters
        ----------
        time_since_tick : float
            Skill time since the last tick, s.

        Returns
        -------
        float
            Infinite where the tempo reaches 0 first.
        """
        interval = time_since_tick - self.time_since_tick
        root = self.tempo**2 + 2 * self.tempo_rate * interval
        speed = self.tempo + math.sqrt(root) if root >= 0 else 0.0
        return 2 * interval / speed if speed > 0 else math.inf

    @classmethod
    def check(cls, state: Any) -> None:
        """Raise a SkillError where the argument of a playback is not one of its states."""
        if not isinstance(state, cls):
            raise SkillError(
                "a playback continues from a PlaybackState, which player.start(position) "
                f"and player.advance(state, seconds) return; it is {shown(state)}."
            )

    def to_arrays(self) -> list[Array]:
        """Return weights, target, history and offset as vectors, then all numbers."""
        arrays = [getattr(self, name).ravel() for name in _ARRAYS]
        numbers = [float(getattr(self, name)) for name in _numbers()]
        return [*arrays, np.array(numbers)]

    @classmethod
    def from_arrays(cls, arrays: Sequence[Array], *, channels: int) -> Self:
        """Return the state from the arrays of `to_arrays`, which are copied."""
        values: dict[str, Any] = {
            name: array.copy() for name, array in zip(_ARRAYS, arrays, strict=False)
        }
        for name in ("history", "offset"):
            values[name] = values[name].reshape(-1, channels)
        values |= zip(_numbers(), arrays[-1].tolist(), strict=True)
        for name in ("component", "step", "seed", "remaps"):
            values[name] = int(values[name])
        return cls(**values)


_ARRAYS = ("weights", "target", "history", "offset")


def _numbers() -> list[str]:
    return [field.name for field in fields(PlaybackState) if field.name not in _ARRAYS]


def start_variances(skill: FourierMovementPrimitive, fraction: float) -> Array:
    """Return lambda of (13) for a start, per channel, shape (D,).

    `fraction` is relative to the movement's half width: root 2 times the standard deviation
    over all channels of a unit together, which a rotation does not change. Only the offset
    adapts to a measured force, because without contact it is not informative.
    """
    check_number(fraction, "start_tolerance", least=0)
    n, d = skill.n_steps, skill.n_channels_
    square, mean = np.zeros(d), np.zeros(d)
    for proportion, c in zip(skill.proportions_, skill.components_, strict=True):
        weights = c.mean.reshape(d, n)
        spread = (c.basis**2 @ c.variances).reshape(d, n)
        square += proportion * (weights**2 + spread + c.noise).sum(axis=1) / n
        mean += proportion * weights[:, 0] / np.sqrt(n)
    variances = np.maximum(square - mean**2, 0) * skill.scales_**2
    units = np.array(skill.units_)
    squares = np.array([2 * variances[units == unit].sum() for unit in units])
    is_force = np.char.endswith(units, "N")  # Also kN.
    squares = np.where(is_force, _FORCE_VARIANCE * squares, fraction**2 * squares)
    return np.maximum(squares, skill.tolerance * np.square(skill.scales_))
