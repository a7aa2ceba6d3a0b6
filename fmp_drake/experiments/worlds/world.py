"""One world: what it is, and what happened in it."""

import hashlib
import importlib.metadata
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

import fmp_drake
from fmp_drake.errors import ExperimentError
from fmp_drake.runs import WipingRun
from fmp_drake.runs.skills import shared_skill
from fmp_drake.station import CheckFeasibility, ParseScenario, models_dir

# Of what a run depends on.
_ROOMS = ("primitives", "systems", "station", "runs")
_LIBRARIES = ("drake", "numpy", "numba", "scipy", "scikit-learn")


class Task(NamedTuple):
    """What a process needs to know of a world that it shall run.

    Attributes
    ----------
    number : int
    scenario : str
        YAML.
    seconds : float
        Simulated time.
    force : bool
        Run it even if it is refused in advance.
    code : str
        The `code_version` that is wanted.

    Examples
    --------
    >>> task = Task(0, "press: {force: 8.0}", 0.1, force=False, code="")
    >>> task.key == task._replace(number=1).key != task._replace(seconds=0.2).key
    True
    """

    number: int
    scenario: str
    seconds: float
    force: bool
    code: str

    @property
    def key(self) -> str:
        """What tells this world, run by this code, from any other."""
        parts = (self.scenario, float(self.seconds).hex(), self.code)
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


@dataclass(kw_only=True)
class Outcome:
    """What happened in a world.

    Attributes
    ----------
    is_feasible : bool
        Whether the check in advance passes.
    verdict : str
        What it says.
    checked : dict
        Its figures.
    metrics : dict or None
        Of the run; None where there was none, or an exception.
    events : str
        What the run says that went wrong, and when.
    error : str
        The exception; empty where there was none.
    cpu_seconds : float

    Examples
    --------
    >>> Outcome(is_feasible=False, verdict="out of reach", checked={}).metrics is None
    True
    """

    is_feasible: bool = True
    verdict: str = ""
    checked: dict[str, Any]
    metrics: dict[str, Any] | None = None
    events: str = ""
    error: str = ""
    cpu_seconds: float = 0.0


def run_world(task: Task) -> Outcome:
    """Check a world in advance, and run it; an exception is an outcome.

    Raises
    ------
    ExperimentError
        Where this is not the code that the task wants.
    """
    if code_version() != task.code:
        raise ExperimentError(
            f"this process runs the code {code_version()}, its driver {task.code}; the "
            "code, or a library, is not the same. Start again."
        )
    begun = time.process_time()
    outcome = Outcome(checked={})
    try:
        with threadpool_limits(limits=1):
            _run(task, outcome)
    except Exception as error:  # noqa: BLE001
        outcome.error = f"{type(error).__name__}: {' '.join(str(error).split())}"
    outcome.cpu_seconds = time.process_time() - begun
    return outcome


def _run(task: Task, outcome: Outcome) -> None:
    scenario = ParseScenario(task.scenario)
    skill, _ = shared_skill(scenario)
    found = CheckFeasibility(scenario, skill)
    outcome.is_feasible, outcome.verdict = found.is_feasible, found.verdict
    outcome.checked = as_stored(found.values)
    if outcome.is_feasible or task.force:
        run = make_run(task.scenario)
        run.advance_to(task.seconds)
        outcome.metrics = as_stored(run.metrics())
        outcome.events = "; ".join(event.text for event in run.events())


def as_stored(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures as they come back from the store, NaN included."""
    stored: dict[str, Any] = json.loads(json.dumps(figures, default=float))
    return stored


def make_run(text: str, **shown: Any) -> WipingRun:
    """Return a run of a world that has not begun.

    Parameters
    ----------
    text : str
        Its scenario, YAML.
    **shown
        How it is shown and what is kept of it, as for `WipingRun`.
    """
    scenario = ParseScenario(text)
    skill, demonstrations = shared_skill(scenario)
    return WipingRun(scenario, skill, demonstrations=demonstrations, **shown)


@cache
def code_version() -> str:
    """Return a hash of all that a run depends on, beside its scenario.

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
