"""Where a playback stands."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaybackState:
    """Everything that decides how a playback goes on, at one instant.

    The weights belong to the last tick, that is to the last sample of the window that
    was passed; everything else belongs to the instant itself.

    Attributes
    ----------
    weights : ndarray, shape (D*T,)
        Fourier weights w at the last tick.
    target : ndarray, shape (D*T,)
        Weights that w is brought to: a component's mean or a sample of it.
    component : int
        Index j* of the component that is tracked.
    step : int
        Sample of the window at the last tick, from K - 1 to T - 1.
    history : ndarray, shape (K, D)
        Desired values at the last K ticks, the newest last.
    offset : ndarray, shape (2, D)
        What is added to the value and the velocity (per second of real time) that the
        weights give. It decays in real time, whatever the tempo.
    blend_time : float
        Time constant of that decay, s.
    time_since_tick : float
        Seconds of the skill since the last tick.
    tempo : float
        Seconds of the skill per second of real time.
    tempo_rate : float
        Change of the tempo, per second.
    sample : bool
        Whether re-mappings draw samples of a component, instead of its mean.
    seed : int
        Of these samples.
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
    (15, 1, 0.07)
    """

    weights: NDArray[np.float64]
    target: NDArray[np.float64]
    component: int
    step: int
    history: NDArray[np.float64]
    offset: NDArray[np.float64]
    blend_time: float
    time_since_tick: float = 0.0
    tempo: float = 1.0
    tempo_rate: float = 0.0
    sample: bool = False
    seed: int = 0
    remaps: int = 0

    def seconds_until(self, time_since_tick: float) -> float:
        """Return after how many seconds of real time the skill gets to a time.

        Parameters
        ----------
        time_since_tick : float
            Seconds of the skill since the last tick.

        Returns
        -------
        float
            Infinite where the tempo falls to zero before.
        """
        ahead = time_since_tick - self.time_since_tick
        root = self.tempo**2 + 2 * self.tempo_rate * ahead
        speed = self.tempo + math.sqrt(root) if root >= 0 else 0.0
        return 2 * ahead / speed if speed > 0 else math.inf

    def to_arrays(self) -> list[NDArray[np.float64]]:
        """Return the weights, target, history and offset, flat, and then all numbers."""
        arrays = [getattr(self, name).ravel() for name in _ARRAYS]
        numbers = [float(getattr(self, name)) for name in _numbers()]
        return [*arrays, np.array(numbers)]

    @classmethod
    def from_arrays(
        cls, arrays: Sequence[NDArray[np.float64]], *, channels: int
    ) -> Self:
        """Return the state that `to_arrays` has taken apart; the arrays are copied."""
        read: dict[str, Any] = {
            name: array.copy() for name, array in zip(_ARRAYS, arrays, strict=False)
        }
        for name in ("history", "offset"):
            read[name] = read[name].reshape(-1, channels)
        read |= zip(_numbers(), arrays[-1].tolist(), strict=True)
        for name in ("component", "step", "seed", "remaps"):
            read[name] = int(read[name])
        return cls(**read)


_ARRAYS = ("weights", "target", "history", "offset")


def _numbers() -> list[str]:
    return [each.name for each in fields(PlaybackState) if each.name not in _ARRAYS]
