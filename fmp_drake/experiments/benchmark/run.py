"""Runs of the benchmark: one JSON file for each method."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from fmp_drake.errors import ExperimentError, FmpError
from fmp_drake.experiments.baselines.method import Method, further_methods
from fmp_drake.experiments.benchmark.built_in import METHODS
from fmp_drake.experiments.benchmark.scores import score_playback, score_predictions
from fmp_drake.experiments.benchmark.splits import (
    PLACES,
    Movement,
    load_movements,
    splits,
)
from fmp_drake.primitives.data.files import write_text
from fmp_drake.processes import Workers, run_tasks

Progress = Callable[[str], None]
# Splits of which a playback is scored.
_PLAYED = ("2", "4", "all")


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One method and how it is scored: the task of a process.

    Attributes
    ----------
    method : str
        Name.
    score : callable
        Returns the scores of the method's class. It is sent to another process.
    """

    method: str
    score: Callable[[type[Method]], "MethodScores"]


@dataclass(kw_only=True)
class MethodScores:
    """Scores of one method: the content of its JSON file.

    Attributes
    ----------
    method : str
    predictions : list of dict
        Movement, cycles, place, and what `score_predictions` returns; or `error`, why
        the method could not learn.
    playbacks : list of dict
        Movement, cycles, place, and what `score_playback` returns.
    cleaning : list of dict
        Movement, cycles, seed, and what `score_cleaning` returns.
    seconds : float
        Processor time.
    """

    method: str
    predictions: list[dict[str, Any]] = field(default_factory=list)
    playbacks: list[dict[str, Any]] = field(default_factory=list)
    cleaning: list[dict[str, Any]] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, other: "MethodScores") -> None:
        """Add other scores of the method."""
        self.predictions += other.predictions
        self.playbacks += other.playbacks
        self.cleaning += other.cleaning
        self.seconds += other.seconds


def all_methods() -> dict[str, type[Method]]:
    """Return the methods by their names: the built-in ones, then those of packages."""
    return {method.name: method for method in (*METHODS, *further_methods())}


def run_benchmark(
    folder: Path,
    out: Path,
    workers: Workers,
    *,
    methods: Sequence[str] = (),
    instants: int = 60,
    progress: Progress = lambda _: None,
) -> dict[str, MethodScores]:
    """Score methods on the recordings of a folder; write a JSON file for each.

    Parameters
    ----------
    folder : pathlib.Path
        Of recordings.
    out : pathlib.Path
        Existing folder for the JSON files.
    workers : Workers
    methods : sequence of str
        Names; all methods where empty.
    instants : int
        Predictions of each split, at most.
    progress : callable
        Called with a sentence about each step.

    Returns
    -------
    dict of str to MethodScores
        Also of methods that an earlier run has written.
    """
    names = chosen_methods(methods)
    movements = load_movements(folder, progress)
    for movement in movements:
        progress(
            f"{movement.name}: {movement.cycles:.1f} cycles in {len(movement.parts)} "
            "parts"
        )
    jobs = [
        Job(
            method=name,
            score=partial(score_method, movement=movement, instants=instants),
        )
        for name in names
        for movement in movements
    ]
    return collect_scores(out, jobs, workers, progress)


def chosen_methods(names: Sequence[str]) -> list[str]:
    """Return the names of the methods to run, all where none is given."""
    available = all_methods()
    for name in names:
        if name not in available:
            raise ExperimentError(
                f"there is no method {name!r}; the methods are {', '.join(available)}."
            )
    return list(names or available)


def collect_scores(
    out: Path, jobs: Sequence[Job], workers: Workers, progress: Progress
) -> dict[str, MethodScores]:
    """Run jobs, write the file of each method when its jobs are done; read all files."""
    finished: dict[Job, MethodScores] = {}
    for done in run_tasks(run_job, jobs, workers):
        if isinstance(done.result, Exception):
            raise done.result
        finished[done.task] = done.result
        name = done.task.method
        own = [job for job in jobs if job.method == name]
        if finished.keys() >= set(own):
            scores = MethodScores(method=name)
            for job in own:
                scores.add(finished[job])
            write_scores(out, scores)
            progress(f"{name}: {scores.seconds:.0f} s of a core")
    return read_scores(out)


def run_job(job: Job) -> MethodScores:
    """Score a method, and measure its processor time."""
    begin = time.process_time()
    with threadpool_limits(limits=1):
        scores = job.score(all_methods()[job.method])
    return replace(scores, seconds=time.process_time() - begin)


def score_method(
    method: type[Method], *, movement: Movement, instants: int, places: int = PLACES
) -> MethodScores:
    """Score a method on the `splits` of a movement with so many places of each."""
    scores = MethodScores(method=method.name)
    for split in splits(movement, places=places):
        where = {
            "movement": movement.name,
            "cycles": split.cycles,
            "place": split.place,
        }
        learner = method()
        try:
            learner.fit(split.learned)
            predicted = score_predictions(learner, split, most=instants)
        except FmpError as error:
            scores.predictions.append({**where, "error": str(error)})
            continue
        scores.predictions.append({**where, **predicted})
        if split.cycles in _PLAYED:
            played = score_playback(learner, movement, split, seed=split.place)
            if played is not None:
                scores.playbacks.append({**where, **played})
    return scores


def write_scores(out: Path, scores: MethodScores) -> None:
    """Write the JSON file of a method; keep the scores that were not measured again."""
    before = read_scores(out).get(scores.method)
    if before is not None:
        cleaned = {row["movement"] for row in scores.cleaning}
        others = [row for row in before.cleaning if row["movement"] not in cleaned]
        scores = replace(
            scores,
            predictions=scores.predictions or before.predictions,
            playbacks=scores.playbacks or before.playbacks,
            cleaning=others + scores.cleaning,
        )
    words = "".join(c if c.isalnum() else "_" for c in scores.method.lower())
    path = out / f"method_{'_'.join(filter(None, words.split('_')))}.json"
    write_text(path, json.dumps(asdict(scores), indent=1) + "\n", ExperimentError)


def read_scores(out: Path) -> dict[str, MethodScores]:
    """Read all JSON files of methods in a folder, the built-in methods first."""
    scores: dict[str, MethodScores] = {}
    for path in sorted(out.glob("method_*.json")):
        content: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        scores[content["method"]] = MethodScores(**content)
    order = [name for name in all_methods() if name in scores]
    return {name: scores[name] for name in dict.fromkeys([*order, *scores])}
