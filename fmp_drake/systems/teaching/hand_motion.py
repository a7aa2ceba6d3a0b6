"""Desired motion of a person's hand: rhythmic, and never exactly repeated."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, check_number, finite_array, read_only
from fmp_drake.systems.surface.surface import Surface

Task = Literal["wiping", "polishing", "eight", "stirring", "pulsing"]

_RATE = 200.0
_SETTLE = 60.0
# Longest path, s, 10 hours and a minute: it is drawn at once, in about a gigabyte.
_LONGEST = 36_060.0


MAX_TURN_RATE = 1.0
"""Greatest rate at which a hand turns a tool that follows a curved board, rad/s."""
# Time over which a hand slows down, s.
_SLOWING = 0.25
# Variation of an angle (rad) and of a force (N) relative to that of a position (m).
_ANGLE, _NEWTON = 4.0, 80.0

type _Sines = tuple[tuple[int, float, float], ...]  # (harmonic, amplitude, phase)


@dataclass(frozen=True, kw_only=True)
class _Figure:
    """A closed path: sums of sines of the phase along x and y of the board.

    `more` has the other channels: name, mean, sines, and variation relative to a
    position's.
    """

    period: float
    x: _Sines
    y: _Sines
    more: tuple[tuple[str, float, _Sines, float], ...] = ()


_FIGURES: dict[str, _Figure] = {
    # Sideways sweeps, three for each time down the board and up again.
    "wiping": _Figure(period=4.8, x=((1, 0.10, np.pi / 2),), y=((3, 0.15, 0.0),)),
    "polishing": _Figure(period=2.0, x=((1, 0.06, 0.0),), y=((1, 0.09, np.pi / 2),)),
    "eight": _Figure(period=3.0, x=((2, 0.06, 0.0),), y=((1, 0.12, 0.0),)),
    # A spoon that leans outwards, so that the hand moves less than the tip.
    "stirring": _Figure(
        period=2.8,
        x=((1, 0.06, np.pi / 2),),
        y=((1, 0.06, 0.0),),
        more=(
            ("z", 0.06, ((2, 0.010, 0.0),), 1.0),
            ("rx", 0.0, ((1, 0.32, 0.0),), _ANGLE),
            ("ry", 0.0, ((1, 0.32, -np.pi / 2),), _ANGLE),
            ("rz", 0.0, ((1, 0.15, 0.5),), _ANGLE),
        ),
    ),
    # Circles that are pressed harder on the far side.
    "pulsing": _Figure(
        period=3.4,
        x=((1, 0.06, 0.0),),
        y=((1, 0.09, np.pi / 2),),
        more=(("force", 10.0, ((1, 2.5, 0.0),), _NEWTON),),
    ),
}


@dataclass(frozen=True, kw_only=True)
class HandVariability:
    """Variability of a person's movement: standard deviations and time constants.

    Attributes
    ----------
    frequency, amplitude : float
        Relative; the amplitudes of the channels wander apart.
    centre : float
        Metres; angles vary by 4 rad, forces by 80 N for each metre.
    tremor : float
        Metres, in the band of 8 to 12 Hz of physiological tremor; for angles and forces as
        the centre.
    slowness : float
        Seconds over which the frequency, amplitude and centre wander.

    Examples
    --------
    >>> steady = HandVariability(amplitude=0.0, tremor=0.0)
    >>> HandMotion.make("eight", duration=5.0, seed=0, variability=steady).at(1.0)[0].shape
    (2,)
    """

    frequency: float = 0.06
    amplitude: float = 0.05
    centre: float = 0.006
    tremor: float = 0.0002
    slowness: float = 4.0


@dataclass(frozen=True, eq=False)
class HandMotion:
    """A sampled wandering path in the plane of the board, or a motion with more channels.

    Attributes
    ----------
    position : ndarray, shape (N, D)
        The channels, 200 samples per second: x and y in the board's frame B, m; z, m; rx, ry
        and rz, the rotation vector from the orientation at rest, in B, rad; force
        on the board, N.
    channels : tuple of str

    Examples
    --------
    >>> motion = HandMotion.make("wiping", duration=10.0, seed=0)
    >>> position, velocity = motion.at(2.5)
    >>> bool(abs(position).max() < 0.3)
    True
    """

    position: Array
    channels: tuple[str, ...] = ("x", "y")

    def __post_init__(self) -> None:
        """Check the positions; a list becomes an array."""
        shape = ("N", len(self.channels))
        path = finite_array(self.position, "the positions", shape, error=SystemsError)
        object.__setattr__(self, "position", path)

    def at(self, time: float) -> tuple[Array, Array]:
        """Return the channels (D,) and their rates (D,) at a time in seconds.

        Before the start and after the end the hand is at rest.
        """
        last = len(self.position) - 1
        x = min(max(time * _RATE, 0.0), float(last))
        i = min(int(x), last - 1)
        change = self.position[i + 1] - self.position[i]
        moves = 0 <= time * _RATE < last
        return self.position[i] + (x - i) * change, moves * change * _RATE

    def slowed(self, surface: Surface) -> "HandMotion":
        """Return the motion, slower where it would turn a tool fast over a curved surface.

        The tool turns with the surface's normal. The path and the duration stay the same,
        so that the end of the path is not reached.

        Parameters
        ----------
        surface : Surface
            On which x and y are (u, v).
        """
        from scipy.ndimage import maximum_filter1d, uniform_filter1d  # Slow to import.

        if surface.is_plane:
            return self
        curvature = np.array([surface.kx, surface.ky])
        turn = np.linalg.norm(np.diff(self.position[:, :2], axis=0) * curvature, axis=1)
        slowness = np.maximum(turn * _RATE / MAX_TURN_RATE, 1.0)
        # The smoothed maximum of the neighbourhood is not below the slowness of any
        # sample.
        width = int(_SLOWING * _RATE)
        slowness = maximum_filter1d(slowness, 2 * width + 1, mode="nearest")
        slowness = uniform_filter1d(slowness, 2 * width + 1, mode="nearest")
        time = np.concatenate([[0.0], np.cumsum(slowness)])
        sample = np.interp(np.arange(len(time)), time, np.arange(len(time)))
        left = np.minimum(sample.astype(int), len(sample) - 2)
        part = (sample - left)[:, None]
        position = (1 - part) * self.position[left] + part * self.position[left + 1]
        return HandMotion(read_only(position), self.channels)

    @classmethod
    def make(
        cls,
        task: Task,
        *,
        duration: float,
        seed: int,
        variability: HandVariability | None = None,
    ) -> "HandMotion":
        """Draw a path for a task; the same seed gives the same path."""
        from scipy.signal import butter, sosfilt  # Slow to import.

        if task not in _FIGURES:
            raise SystemsError(f"task is {task!r}; choose from {', '.join(_FIGURES)}.")
        check_number(
            duration, "duration", above=0, most=_LONGEST, unit="s", error=SystemsError
        )
        figure = _FIGURES[task]
        check_number(seed, "seed", least=0, whole=True, error=SystemsError)
        human = HandVariability() if variability is None else variability
        slowness = human.slowness
        check_number(slowness, "slowness", above=0, unit="s", error=SystemsError)
        rng = np.random.default_rng(seed)
        count = int(np.ceil(duration * _RATE)) + 2
        slow = butter(2, 1 / slowness, fs=_RATE, output="sos")
        shake = butter(2, (8.0, 12.0), "bandpass", fs=_RATE, output="sos")

        def wander(sos: Array, scale: float) -> Array:
            settle = int(_SETTLE * _RATE)
            noise = sosfilt(sos, rng.standard_normal(count + settle))[settle:]
            # The filter's gain for white noise, from its impulse response.
            impulse = np.zeros(settle)
            impulse[0] = 1
            return scale * noise / np.linalg.norm(sosfilt(sos, impulse))

        frequency = np.exp(wander(slow, human.frequency)) / figure.period
        phase = 2 * np.pi * (rng.random() + np.cumsum(frequency) / _RATE)
        channels = (
            ("x", 0.0, figure.x, 1.0),
            ("y", 0.0, figure.y, 1.0),
            *figure.more,
        )
        position = np.empty((count, len(channels)))
        for axis, (_, mean, harmonics, scale) in enumerate(channels):
            path = sum(
                size * np.sin(order * phase + offset)
                for order, size, offset in harmonics
            )
            position[:, axis] = (
                path * np.exp(wander(slow, human.amplitude))
                + wander(slow, scale * human.centre)
                + wander(shake, scale * human.tremor)
            )
            if mean:
                position[:, axis] += mean
        return cls(read_only(position), tuple(name for name, *_ in channels))
