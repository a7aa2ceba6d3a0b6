"""Runs of trials: one in this process, the missing ones of a store, or one again."""

import ctypes
import hashlib
import importlib.metadata
import json
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing, suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat, MeshcatParams
from threadpoolctl import threadpool_limits

import fmp_drake
from fmp_drake.errors import ExperimentError, FmpError, RunError
from fmp_drake.experiments.trials.spec import TrialSpec
from fmp_drake.experiments.trials.store import TrialStore
from fmp_drake.experiments.trials.trial import Trial
from fmp_drake.primitives.data.files import write_text
from fmp_drake.processes import Workers, run_tasks
from fmp_drake.runs import MakeRun, StationRun
from fmp_drake.skills.learning import shared_skill
from fmp_drake.station import CheckFeasibility, ParseScenario, models_dir

# A run depends on the code of these rooms and on these libraries.
_ROOMS = ("primitives", "systems", "station", "runs")
_LIBRARIES = ("drake", "numpy", "numba", "scipy", "scikit-learn")
_FPS, _WIDTH = 20.0, 640


def run_trials(
    store: TrialStore,
    spec: TrialSpec,
    count: int,
    workers: Workers,
    *,
    force: bool = False,
    run: Callable[[Trial], Trial] | None = None,
) -> Generator[tuple[int, int]]:
    """Run those of the first `count` trials that a store does not have yet.

    Each is stored as soon as it is done. After an interruption the same call continues
    with the missing ones.

    Parameters
    ----------
    store : TrialStore
        With the spec's `plan`.
    spec : TrialSpec
    count : int
    workers : Workers
    force : bool
        Also run the infeasible ones.
    run : callable, optional
        Runs one trial and returns it with its result; `run_trial` where None.

    Yields
    ------
    done, total : int
        Numbers of the missing trials.
    """
    seed, seconds = int(store.plan["seed"]), float(store.plan["seconds"])
    code = code_version()
    run = run or partial(run_trial, seconds=seconds, force=force)
    with store.writing():
        finished = store.finished(force=force)
        trials = [
            replace(spec.draw(seed=seed, number=number), code=code)
            for number in range(count)
        ]
        missing = [trial for trial in trials if store.key(trial) not in finished]
        yield 0, len(missing)
        with closing(run_tasks(run, missing, workers)) as running:
            for done, (trial, attempts, result) in enumerate(running, 1):
                if isinstance(result, FmpError):
                    raise result
                if isinstance(result, Exception):
                    reason = f"{type(result).__name__}: {result}"
                    result = replace(trial, error=f"its process ended ({reason})")
                store.keep(replace(result, attempts=attempts))
                yield done, len(missing)


def run_trial(trial: Trial, *, seconds: float, force: bool) -> Trial:
    """Check the feasibility of a trial, and run it; an exception is a result.

    Parameters
    ----------
    trial : Trial
    seconds : float
        Simulated time.
    force : bool
        Run it even if it is infeasible.

    Raises
    ------
    ExperimentError
        Where this process has other code than the trial asks for.
    """
    if code_version() != trial.code:
        raise ExperimentError(
            f"this process runs the code {code_version()}, its driver {trial.code}; the "
            "code, or a library, is not the same. Start again."
        )
    begin = time.process_time()
    trial = replace(trial)
    try:
        with threadpool_limits(limits=1):
            _run(trial, seconds, force)
    except Exception as error:  # noqa: BLE001
        trial.error = f"{type(error).__name__}: {' '.join(str(error).split())}"
    trial.cpu_seconds = time.process_time() - begin
    return trial


def _run(trial: Trial, seconds: float, force: bool) -> None:
    """Run a trial and write the result into it."""
    scenario = ParseScenario(trial.scenario)
    skill, _ = shared_skill(scenario)
    feasibility = CheckFeasibility(scenario, skill)
    trial.is_feasible, trial.verdict = feasibility.is_feasible, feasibility.verdict
    trial.checked = as_stored(feasibility.values)
    _free_memory()
    if trial.is_feasible or force:
        run = make_run(trial.scenario)
        run.advance_to(seconds)
        trial.metrics = as_stored(run.metrics())
        trial.events = "; ".join(event.text for event in run.events())


def _free_memory() -> None:
    """Return memory that learning and checking have freed to the operating system."""
    with suppress(AttributeError):  # Only the C library of GNU has it.
        ctypes.CDLL(None).malloc_trim(0)


def replay_trial(
    trial: Trial, seconds: float, *, html: Path | None = None, video: Path | None = None
) -> dict[str, Any]:
    """Run a trial again, bit-identically where code and machine are the same.

    Parameters
    ----------
    trial : Trial
    seconds : float
        The simulated time of its first run.
    html, video : pathlib.Path, optional
        A page and a film that show it.

    Returns
    -------
    dict
        The metrics, as the store keeps them.
    """
    from fmp_drake.film import FILM_SIGNALS, FilmReel, film_run  # Slow to import.

    with threadpool_limits(limits=1):
        run = make_run(
            trial.scenario,
            meshcat=None if html is None else Meshcat(MeshcatParams(host="localhost")),
            recording=html is not None,
            keep=FILM_SIGNALS if video is not None else (),
        )
        reel = FilmReel(run.station, fps=_FPS)
        if video is not None:
            reel.watch(run.simulator)
        run.advance_to(seconds)
        metrics = as_stored(run.metrics())
        run.remove_controls()
        if html is not None:
            write_text(html, run.html(), RunError)
        if video is not None:
            film_run(run, reel, video, width=_WIDTH)
    return metrics


def as_stored(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return metrics as a store gives them back, NaN included."""
    stored: dict[str, Any] = json.loads(json.dumps(values, default=float))
    return stored


def make_run(text: str, **options: Any) -> StationRun:
    """Return a run of a trial at its start.

    Parameters
    ----------
    text : str
        Its scenario, YAML.
    **options
        As for `StationRun`.
    """
    scenario = ParseScenario(text)
    skill, demonstrations = shared_skill(scenario)
    return MakeRun(scenario, skill, demonstrations=demonstrations, **options)


@cache
def code_version() -> str:
    """Return a hash of everything a run depends on, except its scenario.

    That is the code of the rooms up to `runs`, the models and demonstrations that come
    with it, and the versions of the libraries that compute.
    """
    package = Path(fmp_drake.__file__).parent
    files = [*package.glob("*.py"), *models_dir().glob("*/*.urdf")]
    files += models_dir().glob("demonstrations/*.npz")
    for room in _ROOMS:
        files += (package / room).rglob("*.py")
    digest = hashlib.sha256()
    for file in sorted(files, key=lambda path: (path.name, str(path))):
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    for library in _LIBRARIES:
        digest.update(importlib.metadata.version(library).encode() + b"\0")
    return digest.hexdigest()[:12]
