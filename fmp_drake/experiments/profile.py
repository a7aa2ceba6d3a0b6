"""The sizes of the experiments: samples, repetitions, simulated time."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Profile:
    """How many samples, repetitions and seconds the experiments use.

    Attributes
    ----------
    samples : int
        Trajectories drawn for a heatmap (the paper: 10,000).
    seeds : int
        Repetitions with other seeds of the held-out evaluation.
    folds : int
        Parts of a demonstration that are held out in turn.
    tasks : tuple of str
        Demonstrations of the held-out evaluation.
    predictions : int
        Places at which the next second is predicted.
    robot_seconds : float
        Simulated seconds of wiping by the Panda.

    Examples
    --------
    >>> from fmp_drake.experiments import QUICK
    >>> from dataclasses import replace
    >>> replace(QUICK, samples=100).samples
    100
    """

    samples: int
    seeds: int
    folds: int
    tasks: tuple[str, ...]
    predictions: int
    robot_seconds: float


FULL = Profile(
    samples=10_000,
    seeds=2,
    folds=3,
    tasks=("polishing", "eight", "wiping"),
    predictions=100,
    robot_seconds=20.0,
)
QUICK = Profile(
    samples=1_000,
    seeds=1,
    folds=1,
    tasks=("eight",),
    predictions=20,
    robot_seconds=3.0,
)
