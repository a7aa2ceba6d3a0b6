"""Task metric: the time in which the movements of a method clean a board.

Every method plays a minute, and the same station follows the path: the scenario's arm,
its controller, eraser and ink. Only the path differs.
"""

from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline

from fmp_drake.errors import DemonstrationError, ExperimentError
from fmp_drake.experiments.baselines.method import PAST, RATE, Method
from fmp_drake.experiments.benchmark.run import (
    MethodScores,
    Progress,
    checked_methods,
    collect_scores,
    played_path,
    read_scores,
    reason,
)
from fmp_drake.experiments.benchmark.splits import (
    ALL,
    Movement,
    Split,
    make_movement,
    splits,
)
from fmp_drake.numeric import Array, rms
from fmp_drake.primitives import read_demonstrations
from fmp_drake.processes import Workers
from fmp_drake.skills.placement import place_on_board
from fmp_drake.station import LoadScenario, MakeStation, Scenario
from fmp_drake.station.scenario_parts import FORCE_TOLERANCE
from fmp_drake.station.skill_motion import DESIRED
from fmp_drake.station.tasks.wiping import Wiping
from fmp_drake.systems.ink.grid import CLEAN_BELOW, times_to_clean

_SCENARIO = "table_top"
# Greatest number of cycles to learn from.
_MOST_CYCLES = 4.0
# Time between two measurements, and the time in which a path accelerates from rest, s.
_PERIOD = 0.05
_RAMP = 1.0


def run_cleaning(
    file: Path,
    out: Path,
    workers: Workers,
    *,
    methods: Sequence[str],
    duration: float,
    seeds: int,
    progress: Progress,
) -> dict[str, MethodScores]:
    """Let methods clean the board with the movement of a recording.

    They learn from 4 of its cycles, or from fewer where it is shorter.

    Parameters
    ----------
    file : pathlib.Path
        Recording, which is placed on the board.
    out : pathlib.Path
        Existing folder for the JSON files.
    workers : Workers
    methods : sequence of str
        Names; all methods where empty.
    duration : float
        Simulated time.
    seeds : int
        Runs of each method.
    progress : callable
        Called with a message about each step.

    Returns
    -------
    dict of str to MethodScores
        Scores by method, with those of earlier runs into the same folder.

    Raises
    ------
    ExperimentError
        Where there are other runs of a recording of this name, or it has too few cycles.
    """
    names = checked_methods(methods)
    movement = board_movement(file, progress)
    split = split_to_learn(movement)
    known = {(movement.digest, duration)}
    for method, scores in read_scores(out).items():
        rows = [row for row in scores.cleaning if row["movement"] == movement.name]
        labels = {(row.get("digest"), row.get("duration")) for row in rows}
        if method not in names and rows and (labels != known or len(rows) != seeds):
            raise ExperimentError(
                f"{out} has scores of {method} on {movement.name} that are of another "
                "recording of this name, another duration, or another number of seeds "
                "(--quick). Give another folder by --out."
            )
    score = partial(score_cleaning, movement=movement, split=split, duration=duration)
    parts = [partial(score, seed=seed) for seed in range(seeds)]
    return collect_scores(out, list(product(names, parts)), workers, progress)


def board_movement(file: Path, progress: Progress) -> Movement:
    """Return the movement of a recording in the frame of the scenario's board.

    It is the first recording of the file. `progress` is called with the remarks about it.
    """
    demonstrations, remarks = read_demonstrations([file])
    if len(demonstrations) > 1:
        remarks.append(f"{file.name}: the first of {len(demonstrations)} recordings")
    recording, placed = place_on_board(
        demonstrations[0], scenario=LoadScenario(_SCENARIO)
    )
    for remark in (*remarks, *(f"{file.name}: {remark}" for remark in placed)):
        progress(remark)
    return make_movement(file.stem, [recording.resample(RATE).values])


def split_to_learn(movement: Movement) -> Split:
    """Return the first of the splits of a movement with most cycles, at most 4.

    Raises
    ------
    ExperimentError
        Where the movement has too few cycles.
    """
    candidates = [
        split
        for split in splits(movement)
        if split.cycles != ALL and float(split.cycles) <= _MOST_CYCLES
    ]
    if not candidates:
        raise ExperimentError(
            f"{movement.name} has {movement.cycles:.1f} cycles on the board; expected at "
            "least 2: a method learns from 1.5 cycles, and the rest is held out."
        )
    return max(candidates, key=lambda split: float(split.cycles))


def score_cleaning(
    method: type[Method],
    *,
    movement: Movement,
    split: Split,
    duration: float,
    seed: int,
) -> MethodScores:
    """Let a method clean the board once.

    Parameters
    ----------
    method : type of Method
    movement : Movement
        In the frame of the board, m.
    split : Split
        Split of the movement; the method learns from its training parts.
    duration : float
        Simulated time.
    seed : int
        Seed of the method, and of the sample from which it begins.

    Returns
    -------
    MethodScores
        One row of `cleaning`: the result of `clean_board`; or `error`, the reason for
        which the method could not learn or play.
    """
    labels = {
        "movement": movement.name,
        "digest": movement.digest,
        "duration": duration,
        "cycles": split.cycles,
        "seed": seed,
    }
    learner = method()
    try:
        learner.fit([part.copy() for part in split.training])
        rng = np.random.default_rng(seed)
        longest = max(split.training, key=len)
        first = int(rng.integers(len(longest) - PAST))
        past = longest[first : first + PAST]
        path = played_path(learner, past, round(duration * RATE), seed=seed)
        if path is None:
            raise ExperimentError("it does not play.")
        row = clean_board(path, movement.parts, duration=duration)
    except Exception as error:  # noqa: BLE001 - of any method of a package.
        row = {"error": reason(error)}
    return MethodScores(method=method.name, cleaning=[labels | row])


def clean_board(
    path: Array, demonstrated: Sequence[Array], *, duration: float
) -> dict[str, Any]:
    """Let the station follow a path, and measure the times to clean the board.

    Parameters
    ----------
    path : ndarray, shape (n, 3)
        In the frame of the board at `RATE`, m.
    demonstrated : sequence of ndarray, shape (n, 3)
        Paths whose swept area is to be cleaned.
    duration : float
        Simulated time.

    Returns
    -------
    dict
        `seconds_to_50`, `_90`, `_99` of the demonstrated area, None where not reached;
        `cleaned`, its fraction at the end; `tracking_rms_m`; `force_mean_n`, and
        `force_near`, fraction of the time within 5 N of the desired force.
    """
    scenario = LoadScenario(_SCENARIO)
    reach = np.array(scenario.board.size) / 2 - np.array(scenario.board_footprint()) / 2
    if not np.all(np.isfinite(path)) or np.any(np.abs(path[:, :2]) > reach):
        raise DemonstrationError("the path leaves the board.")
    builder = DiagramBuilder()
    trajectory = _accelerated_path(path, duration)
    station = _add_station(builder, scenario, trajectory)
    ink_board: Any = station.GetSubsystemByName("ink_board")
    area = ink_board.grid.swept_by(demonstrated, scenario.board_footprint())
    simulator = Simulator(builder.Build())
    context = station.GetMyContextFromRoot(simulator.get_context())

    def value(name: str) -> Any:
        return station.GetOutputPort(name).Eval(context)

    times = np.arange(_PERIOD, duration + 1e-9, _PERIOD)
    cleaned, errors, forces = [], [], []
    for until in times:
        simulator.AdvanceTo(until)
        cleaned.append(float(np.mean(value("ink")[area.ravel()] < CLEAN_BELOW)))
        # The rotation vector is before the translation.
        errors.append(float(np.linalg.norm(value("tracking_error")[3:])))
        forces.append(float(value("normal_force")[0]))
    steady_forces = np.array(forces)[times > 2 * _RAMP]
    force_errors = np.abs(steady_forces - scenario.press.force)
    return {
        **{
            f"seconds_to_{100 * fraction:.0f}": time
            for fraction, time in times_to_clean(times, cleaned).items()
        },
        "cleaned": cleaned[-1],
        "tracking_rms_m": rms(errors),
        "force_mean_n": float(steady_forces.mean()),
        "force_near": float(np.mean(force_errors <= FORCE_TOLERANCE)),
    }


def _add_station(
    builder: DiagramBuilder, scenario: Scenario, path: PiecewisePolynomial
) -> Diagram:
    """Add a station whose controller follows a fixed path."""
    start = path.value(0.0).ravel()
    station = MakeStation(scenario, None, task=Wiping(), start=start)
    builder.AddSystem(station)
    sources: list[Any] = [
        TrajectorySource(path.derivative(order)) for order in range(len(DESIRED))
    ]
    sources.append(ConstantVectorSource(np.array([scenario.press.force])))
    for name, source in zip((*DESIRED, "desired_normal_force"), sources, strict=True):
        builder.AddNamedSystem(name, source)
        builder.Connect(source.get_output_port(), station.GetInputPort(name))
    return station


def _accelerated_path(path: Array, duration: float) -> PiecewisePolynomial:
    """Return a path (n, 3) as a twice differentiable trajectory that begins at rest."""
    time = np.arange(round((duration + 1) * RATE) + 1) / RATE
    # Progress along the path: its speed rises from 0 to 1 within the ramp.
    u = np.clip(time / _RAMP, 0, 1)
    progress = np.where(time < _RAMP, _RAMP * (u**3 - 0.5 * u**4), time - 0.5 * _RAMP)
    spline = CubicSpline(np.arange(len(path)) / RATE, path)
    samples = spline(np.minimum(progress, (len(path) - 1) / RATE))
    rest = np.zeros(3)
    make: Any = PiecewisePolynomial.CubicWithContinuousSecondDerivatives
    trajectory: PiecewisePolynomial = make(time, samples.T, rest, rest)
    return trajectory
