"""Where a person's hand wants to be: rhythmic, and never twice the same."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number, read_only

Task = Literal["wiping", "polishing", "eight"]
TASKS: tuple[Task, ...] = ("wiping", "polishing", "eight")

_RATE = 200.0
_SETTLE = 60.0


@dataclass(frozen=True, kw_only=True)
class _Figure:
    """A closed path: sums of sines of the phase along x and y of the board."""

    period: float
    x: tuple[tuple[int, float, float], ...]  # (harmonic, metres, phase)
    y: tuple[tuple[int, float, float], ...]


_FIGURES: dict[str, _Figure] = {
    # Sideways sweeps, three for each time down the board and up again.
    "wiping": _Figure(period=4.8, x=((1, 0.10, np.pi / 2),), y=((3, 0.15, 0.0),)),
    "polishing": _Figure(period=2.0, x=((1, 0.06, 0.0),), y=((1, 0.09, np.pi / 2),)),
    "eight": _Figure(period=3.0, x=((2, 0.06, 0.0),), y=((1, 0.12, 0.0),)),
}


@dataclass(frozen=True, kw_only=True)
class HandVariability:
    """How a person's movement wanders: standard deviations, and how slowly.

    Attributes
    ----------
    frequency, amplitude : float
        Relative; the amplitude of x and y wander apart.
    centre : float
        Metres.
    tremor : float
        Metres, in the band of 8 to 12 Hz of physiological tremor.
    slowness : float
        Seconds over which the frequency, amplitude and centre wander.

    Examples
    --------
    >>> steady = HandVariability(amplitude=0.0, tremor=0.0)
    >>> HandMotion.make("eight", seconds=5.0, seed=0, variability=steady).at(1.0)[0].shape
    (2,)
    """

    frequency: float = 0.06
    amplitude: float = 0.05
    centre: float = 0.006
    tremor: float = 0.0002
    slowness: float = 4.0


@dataclass(frozen=True, eq=False)
class HandMotion:
    """A sampled wandering path in the plane of the board.

    Attributes
    ----------
    position : ndarray, shape (N, 2)
        Metres in the board's frame B, 200 samples per second.

    Examples
    --------
    >>> motion = HandMotion.make("wiping", seconds=10.0, seed=0)
    >>> position, velocity = motion.at(2.5)
    >>> bool(abs(position).max() < 0.3)
    True
    """

    position: NDArray[np.float64]

    def at(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return position (2,) and velocity (2,) at a time in seconds."""
        x = min(max(time * _RATE, 0.0), len(self.position) - 1.001)
        i = int(x)
        here, there = self.position[i], self.position[i + 1]
        return here + (x - i) * (there - here), (there - here) * _RATE

    @classmethod
    def make(
        cls,
        task: Task,
        *,
        seconds: float,
        seed: int,
        variability: HandVariability | None = None,
    ) -> "HandMotion":
        """Draw a path for a task; the same seed gives the same path."""
        from scipy.signal import butter, sosfilt  # Slow to import.

        if task not in _FIGURES:
            raise SystemsError(f"task is {task!r}; choose from {', '.join(TASKS)}.")
        check_number(seconds, "seconds", above=0, unit="s", error=SystemsError)
        figure = _FIGURES[task]
        human = HandVariability() if variability is None else variability
        rng = np.random.default_rng(seed)
        count = int(np.ceil(seconds * _RATE)) + 2
        slow = butter(2, 1 / human.slowness, fs=_RATE, output="sos")
        shake = butter(2, (8.0, 12.0), "bandpass", fs=_RATE, output="sos")

        def wander(sos: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
            settle = int(_SETTLE * _RATE)
            noise = sosfilt(sos, rng.standard_normal(count + settle))[settle:]
            # The filter's gain for white noise, from its impulse response.
            impulse = np.zeros(settle)
            impulse[0] = 1
            return scale * noise / np.linalg.norm(sosfilt(sos, impulse))

        frequency = np.exp(wander(slow, human.frequency)) / figure.period
        phase = 2 * np.pi * (rng.random() + np.cumsum(frequency) / _RATE)
        position = np.empty((count, 2))
        for axis, harmonics in enumerate((figure.x, figure.y)):
            path = sum(
                metres * np.sin(order * phase + offset)
                for order, metres, offset in harmonics
            )
            position[:, axis] = (
                path * np.exp(wander(slow, human.amplitude))
                + wander(slow, human.centre)
                + wander(shake, human.tremor)
            )
        return cls(read_only(position))
