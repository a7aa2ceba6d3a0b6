"""Runs of trials: the missing ones of a store, one in this process, and replays."""

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
from fmp_drake.experiments.trials.spec import TrialSpec, own_files
from fmp_drake.experiments.trials.store import Trial, TrialStore
from fmp_drake.primitives.data.files import write_text
from fmp_drake.processes import Workers, run_tasks
from fmp_drake.runs import CheckWithRehearsal, MakeRun, StationRun
from fmp_drake.runs.judging import failure
from fmp_drake.skills.learning import shared_skill
from fmp_drake.station import ParseScenario, models_dir

# Subpackages and libraries on which the result of a run depends.
_ROOMS = ("primitives", "systems", "station", "skills", "runs")
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

    Each is stored as soon as it is finished. After an interruption the same call continues
    with the missing ones.

    Parameters
    ----------
    store : TrialStore
        With the `plan` of the specification.
    spec : TrialSpec
    count : int
    workers : Workers
    force : bool
        Also run infeasible trials.
    run : callable, optional
        Runs a trial and returns it with its result; by default `run_trial`.

    Yields
    ------
    count, total : int
        Number of trials that have been run, and number of those that were missing.
    """
    seed, duration = int(store.plan["seed"]), float(store.plan["duration"])
    run = run or partial(run_trial, duration=duration, force=force)
    with store.writing():
        trials = [spec.draw(seed=seed, number=number) for number in range(count)]
        trials = [replace(trial, code=trial_version(trial)) for trial in trials]
        missing = store.missing(trials, force=force)
        yield 0, len(missing)
        with closing(run_tasks(run, missing, workers)) as running:
            for number, (trial, attempts, result) in enumerate(running, 1):
                if isinstance(result, FmpError):
                    raise result
                if isinstance(result, Exception):
                    reason = f"{type(result).__name__}: {result}"
                    result = replace(trial, error=f"its process ended ({reason})")
                store.add(replace(result, attempts=attempts))
                yield number, len(missing)


def run_trial(trial: Trial, *, duration: float, force: bool) -> Trial:
    """Check the feasibility of a trial and run it; an exception is stored as a result.

    Parameters
    ----------
    trial : Trial
    duration : float
        Simulated time.
    force : bool
        Run it even if it is infeasible.

    Raises
    ------
    ExperimentError
        If the code of this process differs from that of the trial.
    """
    if (version := trial_version(trial)) != trial.code:
        raise ExperimentError(
            f"this process runs the code {version}, its parent {trial.code}: the code, a "
            "library or a file of the scenario has changed. Start the command again."
        )
    begin = time.process_time()
    trial = replace(trial)
    try:
        with threadpool_limits(limits=1):
            _run(trial, duration, force)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - Drake's failed assertions
        trial.error = failure(error)
    trial.cpu_seconds = time.process_time() - begin
    return trial


def _run(trial: Trial, duration: float, force: bool) -> None:
    """Run a trial and store the result in it."""
    scenario = ParseScenario(trial.scenario)
    skill, _ = shared_skill(scenario)
    feasibility = CheckWithRehearsal(scenario, skill, suggest=False)
    trial.is_feasible, trial.verdict = feasibility.is_feasible, feasibility.verdict
    trial.checked = as_stored(feasibility.values)
    _free_memory()
    if trial.is_feasible or force:
        run = make_run(trial.scenario)
        run.advance_to(duration)
        trial.metrics = as_stored(run.metrics())
        trial.events = "; ".join(event.text for event in run.events())


def _free_memory() -> None:
    """Return the memory that learning and checking have freed to the operating system."""
    with suppress(AttributeError):  # Only glibc has this function.
        ctypes.CDLL(None).malloc_trim(0)


def replay_trial(
    trial: Trial,
    duration: float,
    *,
    html: Path | None = None,
    video: Path | None = None,
) -> dict[str, Any]:
    """Run a trial again; it is bit-identical if code and machine are the same.

    Parameters
    ----------
    trial : Trial
    duration : float
        Simulated time of its first run.
    html, video : pathlib.Path, optional
        Page and film to write.

    Returns
    -------
    dict
        Metrics in the form in which a store returns them.
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
            run.simulator.set_monitor(reel.observe)
        run.advance_to(duration)
        metrics = as_stored(run.metrics())
        run.remove_controls()
        if html is not None:
            write_text(html, run.html(), RunError)
        if video is not None:
            film_run(run, reel, video, width=_WIDTH)
    return metrics


def as_stored(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return metrics in the form in which a store returns them, with NaN."""
    stored: dict[str, Any] = json.loads(json.dumps(values, default=float))
    return stored


def make_run(text: str, **options: Any) -> StationRun:
    """Return the run of a scenario at its start.

    Parameters
    ----------
    text : str
        Scenario (YAML).
    **options
        Options of `StationRun`.
    """
    scenario = ParseScenario(text)
    skill, demonstrations = shared_skill(scenario)
    return MakeRun(scenario, skill, demonstrations=demonstrations, **options)


def trial_version(trial: Trial) -> str:
    """Return the `code_version`, and a hash of the scenario's own files, if it has any."""
    digest, files = hashlib.sha256(), own_files(trial.fields)
    for file in files:
        digest.update(_content_hash(file, file.stat().st_mtime_ns))
    return code_version() + (f"+{digest.hexdigest()[:8]}" if files else "")


@cache
def _content_hash(file: Path, _time: int) -> bytes:
    return hashlib.sha256(file.read_bytes()).digest()


@cache
def code_version() -> str:
    """Return a hash of everything on which a run depends, except its scenario.

    It covers the code of the rooms up to `runs`, the bundled robots and demonstrations, and
    the versions of the numerical libraries.
    """
    package = Path(fmp_drake.__file__).parent
    files = [*package.glob("*.py"), *models_dir().glob("demonstrations/*.npz")]
    for model in models_dir().glob("*/*.[us]*df"):
        files += [model, *model.parent.glob("*.yaml")]
    for room in _ROOMS:
        files += (package / room).rglob("*.py")
    digest = hashlib.sha256()
    for file in sorted(files, key=lambda path: (path.name, str(path))):
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    for library in _LIBRARIES:
        digest.update(importlib.metadata.version(library).encode() + b"\0")
    return digest.hexdigest()[:12]
