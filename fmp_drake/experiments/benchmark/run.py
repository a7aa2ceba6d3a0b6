"""Runs of the benchmark: scores of each method, in one JSON file."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from fmp_drake.errors import DemonstrationError, ExperimentError, FmpError
from fmp_drake.experiments.baselines.alignment import movement_period
from fmp_drake.experiments.baselines.method import (
    PAST,
    RATE,
    Forecast,
    Method,
    further_methods,
)
from fmp_drake.experiments.benchmark.built_in import METHODS
from fmp_drake.experiments.benchmark.splits import (
    PLACES,
    Movement,
    Split,
    load_movements,
    prediction_instants,
    splits,
)
from fmp_drake.numeric import Array, Mask
from fmp_drake.primitives.data.files import write_text
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.processes import Workers, run_tasks

Progress = Callable[[str], None]

STEPS = (5, 10, 20)
"""Steps at which the coverage of the 95 % ellipsoids is measured: 0.25, 0.5 and 1 s."""

# Numbers of learned cycles for which playback is scored as well, and its duration, s.
_PLAYED_CYCLES = ("2", "4", "all")
_PLAYED_SECONDS = 60.0
# Time at the start of a playback that is not scored, s.
_SETTLING_TIME = 10.0
# Distance from the demonstrated path, relative to the size of the movement, up to which a
# playback stays near it.
_NEAR = 0.15
# An exact repetition counts as an error of this size, m.
_LEAST_ERROR = 1e-9


@dataclass(kw_only=True)
class MethodScores:
    """Scores of one method: the content of its JSON file.

    Attributes
    ----------
    method : str
    predictions : list of dict
        Movement, cycles, place, and the scores of `score_predictions`; or `error`, the
        reason for which the method could not learn.
    playbacks : list of dict
        Movement, cycles, place, and the scores of `score_playback`.
    cleaning : list of dict
        Movement, cycles, seed, and the scores of `score_cleaning`.
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


type Job = tuple[str, Callable[[type[Method]], MethodScores]]
"""Name of a method, and a function that returns the scores of its class."""


def all_methods() -> dict[str, type[Method]]:
    """Return the methods by their names: the built-in ones, then those of packages.

    Raises
    ------
    ExperimentError
        If a package's entry point is not a method, or has the name of another one.
    """
    methods: dict[str, type[Method]] = {}
    for method in (*METHODS, *further_methods()):
        file = _file_name(method.name)
        if file in methods:
            raise ExperimentError(
                f"{methods[file].__qualname__} and {method.__qualname__} are both "
                f"called {method.name}, up to punctuation; give the method of your package "
                "another name."
            )
        methods[file] = method
    return {method.name: method for method in methods.values()}


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
        Folder of recordings.
    out : pathlib.Path
        Existing folder for the JSON files.
    workers : Workers
    methods : sequence of str
        Names; all methods where empty.
    instants : int
        Greatest number of predictions for each split.
    progress : callable
        Called with a message about each step.

    Returns
    -------
    dict of str to MethodScores
        Scores by method, with those of earlier runs into the same folder.

    Raises
    ------
    ExperimentError
        Where earlier scores of other methods are of other recordings, or of another number
        of predictions.
    """
    names = checked_methods(methods)
    movements = load_movements(folder, progress)
    known = {(movement.name, movement.digest, instants) for movement in movements}
    for method, scores in read_scores(out).items():
        others = {
            str(row["movement"])
            for row in scores.predictions
            if (row["movement"], row.get("digest"), row.get("instants")) not in known
        }
        if method not in names and others:
            raise ExperimentError(
                f"{out} has scores of {method} on {', '.join(sorted(others))}, which are not of "
                f"the recordings in {folder}, or by another --quick. Give another folder "
                "by --out."
            )
    for movement in movements:
        progress(
            f"{movement.name}: {movement.cycles:.1f} cycles in "
            f"{count_text(len(movement.parts), 'part')}"
        )
    score = partial(score_method, instants=instants)
    parts = [partial(score, movement=movement) for movement in movements]
    return collect_scores(out, list(product(names, parts)), workers, progress)


def checked_methods(names: Sequence[str]) -> list[str]:
    """Return names of methods, those of all methods where there are none.

    Raises
    ------
    ExperimentError
        If a method does not exist.
    """
    available = all_methods()
    for name in names:
        if name not in available:
            raise ExperimentError(
                f"there is no method {name!r}; the methods are {'; '.join(available)}."
            )
    return list(dict.fromkeys(names) or available)


def collect_scores(
    out: Path, jobs: Sequence[Job], workers: Workers, progress: Progress
) -> dict[str, MethodScores]:
    """Run jobs, write the file of each method when its jobs are done; read all files."""
    results: dict[Job, MethodScores] = {}
    for job, _, result in run_tasks(run_job, jobs, workers):
        if isinstance(result, Exception):
            raise result
        results[job] = result
        name = job[0]
        method_jobs = [other for other in jobs if other[0] == name]
        if results.keys() >= set(method_jobs):
            scores = MethodScores(method=name)
            for method_job in method_jobs:
                scores.add(results[method_job])
            write_scores(out, scores)
            progress(f"{name}: {scores.seconds:.0f} s of a core")
    return read_scores(out)


def run_job(job: Job) -> MethodScores:
    """Score a method, and measure its processor time."""
    begin = time.process_time()
    name, score = job
    with threadpool_limits(limits=1):
        scores = score(all_methods()[name])
    return replace(scores, seconds=time.process_time() - begin)


def score_method(
    method: type[Method], *, movement: Movement, instants: int, places: int = PLACES
) -> MethodScores:
    """Score a method on the `splits` of a movement, with `places` as for these."""
    scores = MethodScores(method=method.name)
    for split in splits(movement, places=places):
        labels = {
            "movement": movement.name,
            "digest": movement.digest,
            "instants": instants,
            "cycles": split.cycles,
            "place": split.place,
        }
        learner, playback = method(), None
        try:
            learner.fit([part.copy() for part in split.training])
            predictions = score_predictions(learner, split, count=instants)
            if split.cycles in _PLAYED_CYCLES:
                playback = score_playback(learner, movement, split, seed=split.place)
        except Exception as error:  # noqa: BLE001 - of any method of a package.
            scores.predictions.append({**labels, "error": reason(error)})
            continue
        scores.predictions.append({**labels, **predictions})
        if playback is not None:
            scores.playbacks.append({**labels, **playback})
    return scores


def reason(error: Exception) -> str:
    """Return why a method failed, with the kind of an error that is not foreseen."""
    kind = "" if isinstance(error, FmpError) else f"{type(error).__name__}: "
    return f"{kind}{error}"


def _forecast(method: Method, past: Array, count: int) -> Forecast:
    """Return the forecast of a method; raise an error where it cannot be scored."""
    forecast, d = method.predict(past.copy(), count), past.shape[1]
    for name, shape in (("values", (count, d)), ("covariances", (count, d, d))):
        array = getattr(forecast, name)
        if array is None and name == "covariances":
            continue
        if np.shape(array) != shape or not np.all(np.isfinite(array)):
            raise ExperimentError(
                f"its forecast has {name} of shape {np.shape(array)}; expected finite "
                f"numbers of shape {shape}."
            )
    if forecast.covariances is not None:
        # Its error names covariances that are not positive definite.
        np.linalg.cholesky(forecast.covariances)
    return forecast


def played_path(method: Method, past: Array, count: int, *, seed: int) -> Array | None:
    """Return the playback (count, D) of a method, or None where it does not play.

    Raises
    ------
    ExperimentError
        Where it has another shape.
    """
    path = method.play(past.copy(), count, seed=seed)
    if path is not None and np.shape(path) != (count, past.shape[1]):
        raise ExperimentError(
            f"it plays an array of shape {np.shape(path)}; expected "
            f"{(count, past.shape[1])}."
        )
    return path


def score_predictions(
    method: Method, split: Split, *, count: int
) -> dict[str, float | None]:
    """Score the predictions of a fitted method on the held-out parts of a split.

    Returns
    -------
    dict of str to float or None
        `error_mm`, rms over the next second, at least a nanometre; `log_density`, nats per
        sample, mean over the second; `inside_5`, `inside_10`, `inside_20`, fractions of true
        samples in the 95 % ellipsoids. None where the method has no uncertainty.
    """
    mean_squares, densities, coverage = [], [], []
    for past, truth in prediction_instants(split.held_out, count):
        forecast = _forecast(method, past, len(truth))
        errors = truth - forecast.values
        mean_squares.append(float(np.mean(np.sum(errors**2, axis=1))))
        if forecast.covariances is None:
            continue
        densities.append(float(np.mean(forecast.log_densities(truth))))
        indices = np.array(STEPS) - 1
        coverage.append(
            _are_inside_ellipsoids(errors[indices], forecast.covariances[indices])
        )
    # Errors are compared by their ratios.
    error = max(float(np.sqrt(np.mean(mean_squares))), _LEAST_ERROR)
    scores: dict[str, float | None] = {
        "error_mm": 1e3 * error,
        "log_density": float(np.mean(densities)) if densities else None,
    }
    fractions = np.mean(coverage, axis=0).tolist() if coverage else [None] * len(STEPS)
    names = [f"inside_{step}" for step in STEPS]
    return scores | dict(zip(names, fractions, strict=True))


def score_playback(
    method: Method, movement: Movement, split: Split, *, seed: int
) -> dict[str, Any] | None:
    """Score a minute of playback that continues a held-out part.

    Returns
    -------
    dict or None
        `stays`, fraction of samples near the demonstrated path; `size` and `tempo`,
        relative to the demonstrated ones; `variety`, the difference of successive
        cycles, relative to the demonstrated one (1 is as varied as the person). None
        where the method cannot play.
    """
    past = split.held_out[0][:PAST]
    path = played_path(method, past, round(_PLAYED_SECONDS * RATE), seed=seed)
    if path is None:
        return None
    scores: dict[str, Any] = dict.fromkeys(("stays", "size", "tempo", "variety"))
    if not np.all(np.isfinite(path)):
        return scores | {"stays": 0.0}
    path = path[round(_SETTLING_TIME * RATE) :]
    samples = np.concatenate(movement.parts)
    size = _size([samples])
    distances = KDTree(samples).query(path)[0]
    scores["stays"] = float(np.mean(distances < _NEAR * size))
    scores["size"] = _size([path]) / size
    with suppress(DemonstrationError):
        period = movement_period([path])
        scores["tempo"] = movement.period / period
        demonstrated_variation = _variation(movement.parts, movement.period)
        variation = _variation([path], period)
        if demonstrated_variation is not None and variation is not None:
            scores["variety"] = variation / demonstrated_variation
    return scores


def _size(parts: Sequence[Array]) -> float:
    """Return the standard deviation of positions about their mean, m."""
    return float(np.sqrt(np.sum(np.var(np.concatenate(list(parts)), axis=0))))


def _variation(parts: Sequence[Array], period: float) -> float | None:
    """Return the rms distance between samples and the path one cycle later, m.

    It is the least distance within a quarter of a period about that time, so that changes
    of tempo do not count. None where no part is long enough.
    """
    lags = np.arange(0.75 * period, 1.25 * period, 0.05)
    squares = []
    for y in parts:
        count = len(y) - int(np.ceil(lags[-1]))
        if count > 0:
            times = lags[:, None] + np.arange(count)
            later = CubicSpline(np.arange(len(y)), y)(times)
            squares.append(np.sum((later - y[:count]) ** 2, axis=2).min(axis=0))
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None


def _are_inside_ellipsoids(errors: Array, covariances: Array) -> Mask:
    """Return which errors (n, D) are in the 95 % ellipsoids of covariances (n, D, D)."""
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    squared_distances = np.sum(errors * solved, axis=1)
    out: Mask = squared_distances <= chi2.ppf(0.95, errors.shape[1])
    return out


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
    path = out / _file_name(scores.method)
    write_text(path, json.dumps(asdict(scores), indent=1) + "\n", ExperimentError)


def _file_name(method: str) -> str:
    """Return the name of the file of a method."""
    words = "".join(c if c.isalnum() else "_" for c in method.lower())
    return f"method_{'_'.join(filter(None, words.split('_')))}.json"


def read_scores(out: Path) -> dict[str, MethodScores]:
    """Read all JSON files of methods in a folder, the built-in methods first."""
    scores: dict[str, MethodScores] = {}
    for path in sorted(out.glob("method_*.json")):
        try:
            content: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            scores[content["method"]] = MethodScores(**content)
        except (ValueError, TypeError, KeyError) as error:
            raise ExperimentError(
                f"{path} holds no scores of a method ({error}); delete it, or give "
                "another folder by --out."
            ) from None
    order = [name for name in all_methods() if name in scores]
    return {name: scores[name] for name in dict.fromkeys([*order, *scores])}
