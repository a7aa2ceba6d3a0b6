"""Task metric: how soon the movements of a method clean a board.

Every method plays a minute, and the same station follows the path: the scenario's arm,
its controller, eraser and ink. Nothing but the path differs.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline
from threadpoolctl import threadpool_limits

from fmp_drake.errors import DemonstrationError, ExperimentError, FmpError
from fmp_drake.experiments.baselines.method import PAST, RATE, Array, Method
from fmp_drake.experiments.benchmark.run import (
    MethodScores,
    Progress,
    all_methods,
    chosen_methods,
    collect_scores,
)
from fmp_drake.experiments.benchmark.splits import (
    ALL,
    Movement,
    Split,
    rhythmic_parts,
    splits,
)
from fmp_drake.primitives import read_demonstrations
from fmp_drake.processes import Workers
from fmp_drake.skills.placement import lay_on_board
from fmp_drake.station import LoadScenario, MakeStation, Scenario
from fmp_drake.station.skill_motion import DESIRED
from fmp_drake.station.tasks.wiping import Wiping
from fmp_drake.systems.ink.grid import CLEAN_BELOW

CLEANED = (50, 90, 99)
"""Per cent of the demonstrated area whose times are measured."""
SCENARIO = "table_top"

# Cycles that a method learns from, at most.
_MOST_CYCLES = 4.0
# Samples of a run, s, and the time in which a path is accelerated from rest, s.
_PERIOD = 0.05
_RAMP = 1.0


@dataclass(frozen=True, kw_only=True)
class CleaningJob:
    """One run of one method: the task of a process.

    Attributes
    ----------
    method : str
        Name.
    movement : Movement
        In the frame of the board, m.
    split : Split
        Of the movement.
    seconds : float
        Simulated time.
    seed : int
    """

    method: str
    movement: Movement
    split: Split
    seconds: float
    seed: int


def run_cleaning(
    file: Path,
    out: Path,
    workers: Workers,
    *,
    methods: Sequence[str] = (),
    seconds: float = 60.0,
    seeds: int = 5,
    progress: Progress = lambda _: None,
) -> dict[str, MethodScores]:
    """Let methods clean the board with the movement of a recording.

    They learn from 4 of its cycles, or from fewer where it is shorter.

    Parameters
    ----------
    file : pathlib.Path
        Recording, which is laid on the board.
    out : pathlib.Path
        Existing folder for the JSON files.
    workers : Workers
    methods : sequence of str
        Names; all methods where empty.
    seconds : float
        Simulated time.
    seeds : int
        Runs of each method.
    progress : callable
        Called with a sentence about each step.

    Returns
    -------
    dict of str to MethodScores
        Also of methods that an earlier run has written.
    """
    names = chosen_methods(methods)
    movement = board_movement(file)
    split = split_to_learn(movement)
    jobs = [
        CleaningJob(
            method=name, movement=movement, split=split, seconds=seconds, seed=seed
        )
        for name in names
        for seed in range(seeds)
    ]
    return collect_scores(out, jobs, run_cleaning_job, workers, progress)


def run_cleaning_job(job: CleaningJob) -> MethodScores:
    """Run a method once."""
    begin = time.process_time()
    with threadpool_limits(limits=1):
        scores = score_cleaning(
            all_methods()[job.method],
            job.movement,
            job.split,
            seconds=job.seconds,
            seed=job.seed,
        )
    row = {
        "movement": job.movement.name,
        "cycles": job.split.cycles,
        "seed": job.seed,
    }
    return MethodScores(
        method=job.method,
        cleaning=[row | scores],
        seconds=time.process_time() - begin,
    )


def board_movement(file: Path) -> Movement:
    """Return the movement of a recording in the frame of the scenario's board."""
    demonstrations, _ = read_demonstrations([file])
    placed, _ = lay_on_board(demonstrations[0], scenario=LoadScenario(SCENARIO))
    period, parts = rhythmic_parts([placed.resample(RATE).values])
    return Movement(name=file.stem, parts=tuple(parts), period=period)


def split_to_learn(movement: Movement) -> Split:
    """Return the first split of the most cycles of a movement, but at most 4.

    Raises
    ------
    ExperimentError
        Where the movement has too few cycles.
    """
    found = {
        split.cycles: split
        for split in reversed(list(splits(movement)))
        if split.cycles != ALL and float(split.cycles) <= _MOST_CYCLES
    }
    if not found:
        raise ExperimentError(
            f"{movement.name} has {movement.cycles:.1f} cycles on the board; a method "
            "learns from 1.5 cycles, and some must remain. Give a recording of at least 2."
        )
    return found[max(found, key=float)]


def score_cleaning(
    method: type[Method],
    movement: Movement,
    split: Split,
    *,
    seconds: float,
    seed: int,
) -> dict[str, Any]:
    """Let a method clean the board, and return the metrics.

    Parameters
    ----------
    method : type of Method
    movement : Movement
        In the frame of the board, m.
    split : Split
        Of the movement; the method learns from its learned parts.
    seconds : float
        Simulated time.
    seed : int
        Of the method, and of the sample from which it begins.

    Returns
    -------
    dict
        As `clean_board`; or `error`, why the method could not learn or play.
    """
    learner = method()
    try:
        learner.fit(split.learned)
        rng = np.random.default_rng(seed)
        longest = max(split.learned, key=len)
        first = int(rng.integers(len(longest) - PAST))
        past = longest[first : first + PAST]
        path = learner.play(past, round(seconds * RATE), seed=seed)
        if path is None:
            return {"error": "it does not play."}
        return clean_board(path, movement.parts, seconds=seconds)
    except FmpError as error:
        return {"error": str(error)}


def clean_board(
    path: Array, demonstrated: tuple[Array, ...], *, seconds: float
) -> dict[str, Any]:
    """Let the station follow a path, and measure how soon the board is clean.

    Parameters
    ----------
    path : ndarray, shape (n, 3)
        In the frame of the board at `RATE`, m.
    demonstrated : tuple of ndarray, shape (n, 3)
        Paths whose swept area is to be cleaned.
    seconds : float
        Simulated time.

    Returns
    -------
    dict
        `seconds_to_50`, `_90`, `_99` of the demonstrated area, None where not reached;
        `cleaned`, its fraction at the end; `tracking_rms_m`; `force_mean_n`, and
        `force_near`, fraction of the time within 5 N of the desired force.
    """
    scenario = LoadScenario(SCENARIO)
    size = np.array(scenario.board.size) / 2 - np.array(scenario.eraser.footprint) / 2
    if not np.all(np.isfinite(path)) or np.any(np.abs(path[:, :2]) > size):
        raise DemonstrationError("the path leaves the board.")
    station = _Station(scenario, _from_rest(path, seconds))
    area = station.grid.swept_by(demonstrated, tuple(scenario.eraser.footprint))
    times = np.arange(_PERIOD, seconds + 1e-9, _PERIOD)
    cleaned, errors, forces = [], [], []
    for until in times:
        station.simulator.AdvanceTo(until)
        ink, error, force = station.measure()
        cleaned.append(float(np.mean(ink[area] < CLEAN_BELOW)))
        errors.append(error)
        forces.append(force)
    fractions, settled = np.array(cleaned), np.array(forces)[times > 2 * _RAMP]
    reached: dict[str, Any] = {}
    for percent in CLEANED:
        done = np.flatnonzero(fractions >= percent / 100 - 1e-9)
        reached[f"seconds_to_{percent}"] = float(times[done[0]]) if len(done) else None
    desired = scenario.press.force
    return reached | {
        "cleaned": cleaned[-1],
        "tracking_rms_m": float(np.sqrt(np.mean(np.square(errors)))),
        "force_mean_n": float(settled.mean()),
        "force_near": float(np.mean(np.abs(settled - desired) <= 5.0)),
    }


class _Station:
    """A station whose controller follows a fixed path."""

    def __init__(self, scenario: Scenario, path: PiecewisePolynomial) -> None:
        builder = DiagramBuilder()
        start = path.value(0.0).ravel()
        self._station = MakeStation(scenario, None, task=Wiping(), start=start)
        builder.AddSystem(self._station)
        for name in DESIRED:
            source = builder.AddNamedSystem(name, TrajectorySource(path))
            port = self._station.GetInputPort(name)
            builder.Connect(source.get_output_port(), port)
            path = path.derivative()
        force = ConstantVectorSource(np.array([scenario.press.force]))
        builder.AddNamedSystem("desired_normal_force", force)
        port = self._station.GetInputPort("desired_normal_force")
        builder.Connect(force.get_output_port(), port)
        ink_board: Any = self._station.GetSubsystemByName("ink_board")
        self.grid = ink_board.grid
        self.simulator = Simulator(builder.Build())
        self.simulator.Initialize()

    def measure(self) -> tuple[NDArray[np.float64], float, float]:
        """Return the ink (ny, nx), the distance from the path, m, and the force, N."""
        context = self._station.GetMyContextFromRoot(self.simulator.get_context())
        values: list[Any] = [
            self._station.GetOutputPort(name).Eval(context)
            for name in ("ink", "tracking_error", "normal_force")
        ]
        ink, error, force = values
        # A rotation vector stands before the translation.
        return (
            ink.reshape(self.grid.shape),
            float(np.linalg.norm(error[3:])),
            float(force[0]),
        )


def _from_rest(path: Array, seconds: float) -> PiecewisePolynomial:
    """Return a path (n, 3) as a trajectory that begins at rest, twice differentiable."""
    time = np.arange(round((seconds + 1) * RATE) + 1) / RATE
    # Progress along the path: its speed rises from 0 to 1 within the ramp.
    u = np.clip(time / _RAMP, 0, 1)
    progress = np.where(time < _RAMP, _RAMP * (u**3 - 0.5 * u**4), time - 0.5 * _RAMP)
    spline = CubicSpline(np.arange(len(path)) / RATE, path)
    samples = spline(np.minimum(progress, (len(path) - 1) / RATE))
    rest = np.zeros(3)
    make: Any = PiecewisePolynomial.CubicWithContinuousSecondDerivatives
    trajectory: PiecewisePolynomial = make(time, samples.T, rest, rest)
    return trajectory
