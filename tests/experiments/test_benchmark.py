"""Facts about the benchmark: splits, scores, files and report."""

import json
import pickle
import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from trials_stub import Here

from fmp_drake.errors import DemonstrationError, ExperimentError, FmpError
from fmp_drake.experiments.baselines import method as method_module
from fmp_drake.experiments.baselines.gaussian_processes import (
    DelayGP,
    PeriodicGP,
    RecordingGP,
)
from fmp_drake.experiments.baselines.periodic_dmp import (
    AdaptiveOscillatorDMP,
    PeriodicDMP,
)
from fmp_drake.experiments.baselines.periodic_kmp import PeriodicKMP
from fmp_drake.experiments.benchmark import (
    Forecast,
    Method,
    run_benchmark,
    write_benchmark,
)
from fmp_drake.experiments.benchmark.built_in import (
    FMP,
    METHODS,
    ReplayMethod,
)
from fmp_drake.experiments.benchmark.cleaning import (
    board_movement,
    clean_board,
    run_cleaning,
    split_to_learn,
)
from fmp_drake.experiments.benchmark.findings import benchmark_findings
from fmp_drake.experiments.benchmark.run import (
    MethodScores,
    all_methods,
    read_scores,
    run_job,
    score_method,
    score_playback,
    score_predictions,
    write_scores,
)
from fmp_drake.experiments.benchmark.splits import (
    Movement,
    Split,
    load_movements,
    splits,
)
from fmp_drake.processes import TaskResult

PERIOD = 41.0


def ellipse(count, *, period=PERIOD, seed=None, size=1.0, first=0.0):
    """Return samples of an ellipse; with a seed tempo and size vary like those of a person."""
    phase = 2 * np.pi * (first + np.arange(count)) / period
    if seed is not None:
        rng = np.random.default_rng(seed)
        phase = phase + np.cumsum(0.01 * rng.standard_normal(count))
        size = size * (1 + 0.03 * np.sin(phase / 5.3 + seed))
    return np.column_stack(
        [0.1 * size * np.cos(phase), 0.15 * size * np.sin(phase), 0.01 * np.cos(phase)]
    )


def write_recording(folder, name, values):
    np.savez(folder / name, time=np.arange(len(values)) / 20, position=values)


class Still(Method):
    """Predicts no motion, with a standard deviation of 5 cm."""

    name = "still"

    def fit(self, _):
        """Learn nothing."""

    def predict(self, past, horizon):
        covariances = np.repeat(0.05**2 * np.eye(past.shape[1])[None], horizon, axis=0)
        values = np.repeat(past[-1:], horizon, axis=0)
        return Forecast(values=values, covariances=covariances)


class StillHere(Still):
    name = "still here"


class Shy(Still):
    name = "shy"

    def fit(self, _):
        raise ExperimentError("there are no periods")


# Splits.


def test_splits_learn_from_their_number_of_cycles_and_score_on_the_rest():
    path = ellipse(500, seed=1)
    movement = Movement(name="ring", parts=(path,), period=PERIOD)
    rows = {tuple(row) for row in path}
    places = {}
    for split in splits(movement):
        learned = {tuple(row) for y in split.training for row in y}
        held_out = {tuple(row) for y in split.held_out for row in y}
        assert learned < rows
        assert held_out < rows
        assert not learned & held_out
        places.setdefault(split.cycles, []).append(len(learned))
    assert list(places) == ["1.5", "2", "3", "4", "8", "all"]
    for cycles, counts in places.items():
        if cycles != "all":
            assert set(counts) == {round(float(cycles) * PERIOD)}
    assert len(places["2"]) == 3
    assert all(abs(count - 1000 / 3) <= 1 for count in places["all"])


def test_splits_of_several_recordings_count_the_cycles_of_all():
    parts = tuple(ellipse(80, seed=i) for i in range(6))
    movement = Movement(name="ring", parts=parts, period=40.0)
    by_cycles = {}
    for split in splits(movement):
        by_cycles.setdefault(split.cycles, []).append(split)
    assert set(by_cycles) == {"1.5", "2", "3", "4", "8", "all"}
    assert [len(y) for y in by_cycles["3"][0].training] == [80, 40]
    assert all(len(split.training) == 5 for split in by_cycles["all"])


def test_recordings_of_few_cycles_are_one_movement_together(tmp_path):
    for i in range(3):
        write_recording(tmp_path, f"short_{i}", ellipse(85, seed=i))
    write_recording(tmp_path, "long_1", ellipse(400, seed=7))
    noise = 1e-3 * np.random.default_rng(0).standard_normal((300, 3))
    line = np.linspace([0, 0, 0], [0.1, 0, 0], 300) + noise
    write_recording(tmp_path, "line", line)
    (tmp_path / "README.md").write_text("no recording")
    messages = []
    movements = load_movements(tmp_path, messages.append)
    assert [(m.name, len(m.parts)) for m in movements] == [("long_1", 1), ("short", 3)]
    assert all(m.period == pytest.approx(PERIOD, rel=0.05) for m in movements)
    (message,) = messages
    assert message.startswith("line is left out: no part of it recurs")


def test_recordings_of_one_stem_are_movements_of_their_own(tmp_path):
    write_recording(tmp_path, "ring", ellipse(170, seed=1))
    values = np.column_stack([np.arange(170) / 20, ellipse(170, seed=2)])
    np.savetxt(tmp_path / "ring.csv", values, delimiter=",", header="time,x,y,z")
    np.save(tmp_path / "other.npy", np.stack([values + 0.01, values + 0.02]))
    movements = load_movements(tmp_path)
    names = ["other_1", "other_2", "ring.csv", "ring.npz"]
    assert [movement.name for movement in movements] == names
    assert len({movement.digest for movement in movements}) == 4


def test_movements_have_names_of_their_own(tmp_path):
    write_recording(tmp_path, "wipe", ellipse(300, seed=1))
    for i in range(1, 4):
        write_recording(tmp_path, f"wipe_{i}", ellipse(85, seed=i))
    movements = load_movements(tmp_path)
    assert [(m.name, len(m.parts)) for m in movements] == [("wipe", 1), ("wipe (2)", 3)]


def test_short_recordings_of_other_channels_are_another_movement(tmp_path):
    for i in (1, 2):
        write_recording(tmp_path, f"wipe_{i}", ellipse(85, seed=i))
        write_recording(tmp_path, f"wipe_{i + 2}", ellipse(85, seed=i)[:, :2])
    shapes = {m.name: [y.shape[1] for y in m.parts] for m in load_movements(tmp_path)}
    assert shapes == {"wipe": [3, 3], "wipe (2)": [2, 2]}


def test_movement_that_cannot_be_divided_is_left_out_with_the_reason(tmp_path):
    write_recording(tmp_path, "short", ellipse(74, seed=1))
    with pytest.raises(FmpError, match=r"at least 1\.9 cycles are needed"):
        load_movements(tmp_path)
    write_recording(tmp_path, "long", ellipse(300, seed=2))
    messages = []
    assert [m.name for m in load_movements(tmp_path, messages.append)] == ["long"]
    assert re.search(
        r"short is left out: 1\.8 cycles of .* s cannot be divided; at least 1\.9 cycles "
        r"are needed, and after 1\.5 of them at least 1\.7 s",
        "".join(messages),
    )


def test_copy_of_a_recording_is_left_out(tmp_path):
    for name in ("ring_1", "copy_of_ring"):
        write_recording(tmp_path, name, ellipse(300, seed=1))
    for i, seed in enumerate((2, 3, 2), 1):
        write_recording(tmp_path, f"short_{i}", ellipse(85, seed=seed))
    messages = []
    movements = load_movements(tmp_path, messages.append)
    # Of short_1 and its copy, one would be learned from and the other scored on.
    assert [(m.name, len(m.parts)) for m in movements] == [
        ("copy_of_ring", 1),
        ("short", 2),
    ]
    assert messages == [
        "ring_1 is left out: it is a copy of copy_of_ring.",
        "short_3 is left out: it is a copy of short_1.",
    ]


def test_remarks_on_recordings_are_shown(tmp_path):
    values = np.column_stack([np.arange(300) / 20, 1000 * ellipse(300, seed=1)])
    np.savetxt(tmp_path / "a.csv", values, delimiter=",", header="time,x,y,z")
    messages = []
    load_movements(tmp_path, messages.append)
    assert "m wide" in "".join(messages)


def test_folder_without_a_repeated_movement_is_refused(tmp_path):
    with pytest.raises(FmpError, match=r"no recording in which a movement repeats"):
        load_movements(tmp_path)


# Scores.


class Truthful(Method):
    """Predicts the truth plus Gaussian noise, with the covariance of the noise."""

    name = "truthful"
    root = np.array([[0.02, 0.0, 0.0], [0.01, 0.01, 0.0], [0.0, 0.0, 0.005]])
    variance_factor = 1.0

    def __init__(self):
        self.rng = np.random.default_rng(0)
        self.truth = {}

    def fit(self, recordings):
        for y in recordings:
            for i in range(len(y) - 29):
                self.truth[tuple(y[i])] = y[i + 10 : i + 30]

    def predict(self, past, horizon):
        noise = self.rng.standard_normal((horizon, 3)) @ self.root.T
        covariance = self.variance_factor * self.root @ self.root.T
        return Forecast(
            values=self.truth[tuple(past[0])] + noise,
            covariances=np.repeat(covariance[None], horizon, axis=0),
        )


def test_calibrated_forecasts_are_scored_as_such():
    path = ellipse(2000, seed=3)
    split = Split(cycles="2", place=0, training=(path,), held_out=(path,))
    method = Truthful()
    method.fit([path])
    scores = score_predictions(method, split, count=1500)
    covariance = method.root @ method.root.T
    assert scores["error_mm"] == pytest.approx(
        1e3 * np.sqrt(np.trace(covariance)), rel=0.02
    )
    entropy = multivariate_normal(np.zeros(3), covariance).entropy()
    assert scores["log_density"] == pytest.approx(-entropy, abs=0.05)
    for step in (5, 10, 20):
        assert scores[f"inside_{step}"] == pytest.approx(0.95, abs=0.02)
    method.variance_factor = 0.25
    narrow = score_predictions(method, split, count=1500)
    assert narrow["inside_10"] < 0.6
    assert narrow["log_density"] < scores["log_density"]


def test_an_exact_forecast_has_a_least_error():
    split = Split(cycles="2", place=0, training=(), held_out=(np.ones((60, 3)),))
    scores = score_predictions(Still(), split, count=5)
    assert scores["error_mm"] == pytest.approx(1e-6)


class Centred(Still):
    """Changes the recordings that it gets."""

    name = "centred"

    def fit(self, recordings):
        for y in recordings:
            y -= y.mean(axis=0)

    def predict(self, past, horizon):
        past -= 1.0
        return super().predict(past + 1.0, horizon)


def test_a_method_cannot_change_the_recordings():
    movement = Movement(name="ring", parts=(ellipse(300, seed=1),), period=PERIOD)
    before = movement.parts[0].copy()
    expected = score_method(Still, movement=movement, instants=5)
    changed = score_method(Centred, movement=movement, instants=5)
    assert np.array_equal(movement.parts[0], before)
    errors = [[row["error_mm"] for row in m.predictions] for m in (changed, expected)]
    assert errors[0] == pytest.approx(errors[1])


def of_covariance(covariance):
    """Return a function that changes the covariances of a forecast."""
    return lambda f: replace(f, covariances=np.broadcast_to(covariance, (20, 3, 3)))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            lambda f: replace(f, values=f.values[:1]),
            r"values of shape (1, 3); expected",
        ),
        (lambda f: replace(f, values=f.values * np.nan), "expected finite numbers"),
        (lambda f: replace(f, covariances=np.ones(20)), "covariances of shape (20,)"),
        (of_covariance(np.zeros((3, 3))), "LinAlgError: "),
        (of_covariance(-np.eye(3)), "not positive definite"),
        (lambda _: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_a_wrong_forecast_ends_no_other_method(change, reason):
    class Wrong(Still):
        name = "wrong"

        def predict(self, past, horizon):
            return change(super().predict(past, horizon))

    movement = Movement(name="ring", parts=(ellipse(300, seed=1),), period=PERIOD)
    scores = score_method(Wrong, movement=movement, instants=5)
    assert len(scores.predictions) == len([*splits(movement)])
    assert all(reason in row["error"] for row in scores.predictions)


def test_a_playback_of_another_length_is_not_scored():
    class Short(Still):
        name = "short"

        def play(self, past, count, *, seed):  # noqa: ARG002
            return past

    movement = Movement(name="ring", parts=(ellipse(300, seed=1),), period=PERIOD)
    scores = score_method(Short, movement=movement, instants=5)
    errors = {row["cycles"]: row.get("error", "") for row in scores.predictions}
    assert "shape (10, 3); expected (1200, 3)" in errors["2"]
    assert errors["1.5"] == ""
    assert scores.playbacks == []


class Plays(Still):
    """Plays an ellipse of another size and tempo."""

    def __init__(self, **options):
        self.options = options

    def play(self, past, count, *, seed):  # noqa: ARG002
        return ellipse(count, **self.options)


@pytest.mark.parametrize(
    ("options", "stays", "size", "tempo"),
    [
        ({}, 1.0, 1.0, 1.0),
        ({"size": 0.5}, 0.0, 0.5, 1.0),
        ({"period": PERIOD / 1.25}, 1.0, 1.0, 1.25),
    ],
)
def test_playback_is_compared_with_the_demonstration(options, stays, size, tempo):
    path = ellipse(800, seed=5)
    movement = Movement(name="ring", parts=(path,), period=PERIOD)
    split = Split(cycles="2", place=0, training=(path,), held_out=(path,))
    scores = score_playback(Plays(**options), movement, split, seed=0)
    assert scores["stays"] == pytest.approx(stays, abs=0.02)
    assert scores["size"] == pytest.approx(size, rel=0.03)
    assert scores["tempo"] == pytest.approx(tempo, rel=0.02)
    assert scores["variety"] < 0.2
    varied = score_playback(Plays(seed=8), movement, split, seed=0)
    assert varied["variety"] == pytest.approx(1.0, abs=0.4)


def test_playback_that_stops_has_no_tempo():
    path = ellipse(800, seed=5)
    movement = Movement(name="ring", parts=(path,), period=PERIOD)
    split = Split(cycles="2", place=0, training=(path,), held_out=(path,))
    scores = score_playback(Still(), movement, split, seed=0)
    assert scores["size"] == pytest.approx(0.0, abs=1e-9)
    assert scores["tempo"] is None


# Methods.


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_every_method_predicts_better_than_no_motion(method):
    learned, held_out = ellipse(360, seed=1), ellipse(200, seed=2)
    split = Split(cycles="8", place=0, training=(learned,), held_out=(held_out,))
    learner = method()
    learner.fit([learned])
    scores = score_predictions(learner, split, count=15)
    still = score_predictions(Still(), split, count=15)
    assert scores["error_mm"] < 0.5 * still["error_mm"]
    forecast = learner.predict(held_out[:10], 20)
    assert forecast.values.shape == (20, 3)
    if forecast.covariances is not None:
        assert np.all(np.linalg.eigvalsh(forecast.covariances) > 0)
    path = learner.play(held_out[:10], 100, seed=0)
    assert path.shape == (100, 3)
    assert np.all(np.isfinite(path))


@pytest.mark.parametrize("method", [ReplayMethod, DelayGP, RecordingGP, PeriodicDMP])
def test_baselines_learn_from_one_and_a_half_cycles(method):
    path = ellipse(62)
    learner = method()
    learner.fit([path])
    later = ellipse(40, first=20)
    forecast = learner.predict(later[:10], 20)
    off = np.linalg.norm(forecast.values - later[10:30], axis=1)
    still = np.linalg.norm(later[9] - later[10:30], axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.3 * np.sqrt(np.mean(still**2))


def test_delay_gp_is_less_certain_far_from_the_recording():
    method = DelayGP()
    method.fit([ellipse(300, seed=4)])
    near = method.predict(ellipse(10), 20).covariances
    far = method.predict(ellipse(10, size=2.0), 20).covariances
    assert np.trace(far[-1]) > 4 * np.trace(near[-1])


def test_kmp_passes_through_the_observed_samples():
    method = PeriodicKMP()
    method.fit([ellipse(400, seed=4)])
    past = ellipse(10, first=13, size=1.1)
    ahead = method.predict(past, 20).values
    assert np.linalg.norm(ahead[0] - past[-1]) < 1.6 * np.linalg.norm(
        past[-1] - past[-2]
    )


def test_oscillator_finds_the_frequency_of_the_recording():
    method = AdaptiveOscillatorDMP()
    method.fit([ellipse(500)])
    assert method.frequency_ == pytest.approx(2 * np.pi / PERIOD, rel=0.03)


# Files and report.


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    for i in (1, 2):
        write_recording(folder, f"ring_{i}", ellipse(170, seed=i))
    return folder


@pytest.fixture
def few(monkeypatch):
    """Replace the built-in methods by four quick ones."""
    monkeypatch.setattr(
        "fmp_drake.experiments.benchmark.run.METHODS",
        (ReplayMethod, StillHere, Still, Shy),
    )


@pytest.mark.usefixtures("few")
def test_every_method_has_a_file_and_a_row(folder, command, tmp_path, monkeypatch):
    monkeypatch.setattr("fmp_drake.apps.benchmark.LocalWorkers", lambda _: Here())
    out = tmp_path / "out"
    result = command("benchmark", folder, "--out", out, "--quick")
    assert result.code == 0, result
    names = {path.name for path in out.iterdir()}
    assert {"report.html", "results.json", "benchmark_error.png"} <= names
    files = {n for n in names if n.startswith("method_")}
    assert files == {
        f"method_{name}.json" for name in ("replay", "still_here", "still", "shy")
    }
    replay = json.loads((out / "method_replay.json").read_text())
    assert {row["movement"] for row in replay["predictions"]} == {"ring_1", "ring_2"}
    assert {row["cycles"] for row in replay["predictions"]} == {"1.5", "2", "3", "all"}
    assert all(row["error_mm"] > 0 for row in replay["predictions"])
    assert replay["playbacks"][0]["stays"] > 0.9
    page = (out / "report.html").read_text()
    for name in ("replay", "still here", "still"):
        assert f"<td>{name}</td>" in page
    assert "shy could not learn from" in page
    assert "there are no periods" in page


@pytest.mark.usefixtures("few")
def test_one_method_is_run_again_and_the_others_are_kept(folder, tmp_path):
    first = run_benchmark(folder, tmp_path, Here(), instants=5)
    before = (tmp_path / "method_replay.json").stat().st_mtime_ns
    scores = run_benchmark(folder, tmp_path, Here(), methods=["still"], instants=5)
    assert list(scores) == list(first)
    assert (tmp_path / "method_replay.json").stat().st_mtime_ns == before


@pytest.mark.usefixtures("few")
def test_method_that_is_named_twice_is_scored_once(folder, tmp_path):
    names = ["still", "still"]
    scores = run_benchmark(folder, tmp_path, Here(), methods=names, instants=5)
    rows = scores["still"].predictions
    cases = {(row["movement"], row["cycles"], row["place"]) for row in rows}
    assert len(rows) == len(cases)


def test_scores_of_other_recordings_are_not_mixed(folder, tmp_path):
    row = {"movement": "elsewhere", "cycles": "4", "place": 0, "error": "none"}
    write_scores(tmp_path, MethodScores(method="replay", predictions=[row]))
    with pytest.raises(ExperimentError, match=r"replay on elsewhere.*another folder"):
        run_benchmark(folder, tmp_path, Here(), methods=["FMP"], instants=5)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("instants", [5, 6])
def test_scores_of_other_recordings_of_the_same_name_are_not_mixed(
    folder, instants, tmp_path
):
    run_benchmark(folder, tmp_path, Here(), methods=["still"], instants=5)
    if instants == 5:
        write_recording(folder, "ring_1", ellipse(170, seed=9))
    with pytest.raises(ExperimentError, match=r"still on ring_1.*another folder"):
        run_benchmark(folder, tmp_path, Here(), methods=["replay"], instants=instants)


def test_scores_that_cannot_be_read_are_named(tmp_path):
    for text in ('{"method": "repl', '{"method": "replay", "x": 1}', "[]"):
        (tmp_path / "method_replay.json").write_text(text)
        with pytest.raises(
            ExperimentError, match=r"method_replay\.json holds no scores"
        ):
            read_scores(tmp_path)


@pytest.mark.usefixtures("few")
def test_rows_do_not_depend_on_which_job_ends_first(folder, tmp_path, monkeypatch):
    def backwards(function, tasks, _):
        return (TaskResult(task, 1, function(task)) for task in reversed(tasks))

    written = []
    for name in ("forwards", "backwards"):
        out = tmp_path / name
        out.mkdir()
        scores = run_benchmark(folder, out, Here(), instants=5)
        written.append(
            [(m.method, m.predictions, m.playbacks) for m in scores.values()]
        )
        monkeypatch.setattr("fmp_drake.experiments.benchmark.run.run_tasks", backwards)
    assert written[0] == written[1]


def test_job_needs_no_recording_but_its_own_movement():
    movement = Movement(name="ring", parts=(ellipse(300, seed=1),), period=PERIOD)
    score = partial(score_method, movement=movement, instants=5)
    job = (ReplayMethod.name, score)
    here, there = run_job(job), run_job(pickle.loads(pickle.dumps(job)))
    assert {row["movement"] for row in here.predictions} == {"ring"}
    assert there.predictions == here.predictions
    assert there.playbacks == here.playbacks


def test_unknown_method_is_refused(folder, refused, tmp_path):
    line = refused("benchmark", folder, "--out", tmp_path / "x", "--method", "magic")
    assert "no method 'magic'; the methods are FMP" in line


def test_installed_package_adds_a_method(monkeypatch):
    entry = SimpleNamespace(name="still", value="package:Still", load=lambda: Still)
    monkeypatch.setattr(method_module, "entry_points", lambda **_: [entry])
    assert all_methods()["still"] is Still
    wrong = SimpleNamespace(name="bad", value="package:bad", load=lambda: 3)
    monkeypatch.setattr(method_module, "entry_points", lambda **_: [wrong])
    with pytest.raises(ExperimentError, match=r"the entry point bad .* subclass of"):
        all_methods()
    for name, message in (
        (None, "package:bad has no name"),
        ("FMP", "both called FMP"),
        ("FMP mixture", "both called FMP mixture, up to punctuation"),
    ):
        same = type("Same", (Still,), {"name": name})
        wrong.load = partial(lambda method: method, same)
        with pytest.raises(ExperimentError, match=message):
            all_methods()


def test_missing_folder_is_refused(refused, tmp_path):
    out = tmp_path / "x"
    assert "there is no folder" in refused("benchmark", tmp_path / "no", "--out", out)


# Cleaning.


def rows_of(path, name):
    """Return the rows of a table of a report, by their first cells."""
    finding = next(f for f in benchmark_findings(read_scores(path)) if f.name == name)
    return {row[0]: row[1:] for row in finding.table}


def test_report_counts_the_cases_no_worse_than_the_best_of_the_others():
    def scored(method, errors, densities):
        rows = [
            {
                "movement": name,
                "cycles": "2",
                "place": 0,
                "error_mm": e,
                "log_density": d,
            }
            for name, e, d in zip("abc", errors, densities, strict=True)
        ]
        return MethodScores(method=method, predictions=rows)

    # Better in a and c than replay, in a alone than the Gaussian process, too.
    mine = scored(FMP.name, (1.0, 3.0, 2.0), (6.0, 7.0, 5.0))
    replayed = scored(ReplayMethod.name, (1.0, 2.0, 3.0), (9.0, 9.0, 9.0))
    process = scored(DelayGP.name, (2.0, 4.0, 1.0), (5.0, 8.0, 5.0))
    scores = {m.method: m for m in (mine, replayed, process)}
    error, density, *_ = benchmark_findings(scores)
    # Cycles that no recording has are left out.
    counts = {len({row["cycles"] for row in s.predictions}) for s in scores.values()}
    assert [len(error.table[0]) - 1] == [*counts]
    assert len(error.figure.axes[0].get_xticks()) == len(error.table[0]) - 1
    best = f"{ReplayMethod.name}, {DelayGP.name}"
    assert f"No worse than the best of {best} in 1 of 3 cases" in error.shows
    assert f"No worse than the best of {best} in 0 of 3 cases" in density.shows


def test_methods_are_compared_over_the_places_that_both_learned_from():
    def scored(method, errors):
        rows = [
            {"movement": "a", "cycles": "all", "place": place}
            | ({"error": "too short"} if e is None else {"error_mm": e})
            for place, e in enumerate(errors)
        ]
        return MethodScores(method=method, predictions=rows)

    mine = scored(FMP.name, (2.0, None, 4.0))
    replayed = scored(ReplayMethod.name, (4.0, 22.0, 2.0))
    process = scored(DelayGP.name, (2.5, 1.0, 5.0))
    findings = benchmark_findings({m.method: m for m in (mine, replayed, process)})
    tables = {finding.name: finding.table for finding in findings}
    ratios = {row[0]: row[1] for row in tables["benchmark_error"][1:]}
    assert ratios[FMP.name] == "1.00 (1.00 to 1.00)"
    assert ratios[DelayGP.name] == "0.30 (0.30 to 0.30)"
    assert "in 1 of 1 cases" in findings[0].shows
    assert tables["benchmark_movements"][1] == ["a", "3.0 [2]", "9.3", "2.8"]


def scores_of(method, cycles="2", **values):
    """Return scores of a method with one prediction."""
    row = {"movement": "a", "cycles": cycles, "place": 0, **values}
    return {method: MethodScores(method=method, predictions=[row])}


def test_methods_that_are_run_without_the_reference_have_values_of_their_own():
    scores = scores_of("still", error_mm=12.0, log_density=-20.0)
    error, density, coverage = benchmark_findings(scores)
    assert error.title == "Error of the next second, mm"
    assert error.figure.axes[0].get_ylabel() == "error (mm)"
    assert error.table[1] == ["still", "12.00 (12.00 to 12.00)"]
    assert density.table[1] == ["still", "-20.0 (least -20.0)"]
    low, high = density.figure.axes[0].get_ylim()
    assert low < -20 < high
    assert coverage.title == "Coverage of the 95 % tubes"
    for finding in (error, density):
        assert "replay" not in finding.shows
        assert PeriodicGP.name not in finding.shows
    replayed = scores_of(ReplayMethod.name, error_mm=6.0)
    error, *_ = benchmark_findings(scores | replayed)
    assert error.table[1] == ["still", "2.00 (2.00 to 2.00)"]


def test_report_has_no_section_without_values():
    findings = benchmark_findings(scores_of("still", error_mm=12.0))
    assert [finding.name for finding in findings] == ["benchmark_error"]
    findings = benchmark_findings(scores_of("still", "all", error_mm=12.0))
    names = ["benchmark_error", "benchmark_movements"]
    assert [finding.name for finding in findings] == names


def test_report_says_why_a_method_has_no_values(tmp_path):
    scores = scores_of("shy", error="no periods") | scores_of("still", error_mm=12.0)
    run = {"movement": "ring", "cycles": "4", "duration": 5.0, "error": "it falls."}
    scores["still"].cleaning = [run | {"seed": seed} for seed in (0, 1)]
    write_benchmark(tmp_path, scores, folder=tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert (
        "shy could not learn from, or predict, 1 of 1 split: no periods. still could not "
        "clean the board in 2 of 2 runs: it falls.</p>"
    ) in page


def test_lines_of_many_methods_differ_in_more_than_the_dashes():
    rows = [{"movement": "a", "cycles": "all", "place": 0, "error_mm": 1.0}]
    names = [ReplayMethod.name, *(f"method {i}" for i in range(1, 14))]
    scores = {name: MethodScores(method=name, predictions=rows) for name in names}
    error, *_ = benchmark_findings(scores)
    lines = error.figure.axes[0].lines[: len(names)]
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == len(names)


def test_cleaning_needs_no_folder_of_recordings(tmp_path, monkeypatch, refused):
    def clean(path, *_, **__):
        raise ExperimentError(f"cleaned with {path.name}")

    monkeypatch.setattr("fmp_drake.apps.benchmark.run_cleaning", clean)
    out = ("--out", tmp_path / "out")
    assert "there is no folder" in refused("benchmark", "nothing", *out)
    said = refused("benchmark", "nothing", "--clean", "a.csv", *out)
    assert "cleaned with a.csv" in said


def test_report_counts_runs_that_never_clean_the_board(tmp_path):
    run = {
        "movement": "wiping",
        "cycles": "4",
        "seconds_to_50": 3.0,
        "seconds_to_90": None,
        "seconds_to_99": None,
        "cleaned": 0.84,
        "tracking_rms_m": 0.003,
        "force_mean_n": 9.9,
        "force_near": 1.0,
        "duration": 60.0,
    }
    runs = [{**run, "seed": 0}, {**run, "seed": 1, "seconds_to_90": 20.0}]
    labels = {"movement": "wiping", "cycles": "4", "duration": 60.0}
    failed = {**labels, "seed": 2, "error": "off the board"}
    write_scores(tmp_path, MethodScores(method="replay", cleaning=[*runs, failed]))
    rows = rows_of(tmp_path, "benchmark_cleaning_wiping")
    assert rows["replay"][:4] == [
        "2 of 3",
        "3.0 ± 0.0",
        "20.0 ± 0.0, 1 never",
        "2 never",
    ]
    assert rows["replay"][4] == "84.0 ± 0.0"
    # Predictions that are measured later do not lose the runs.
    write_scores(tmp_path, MethodScores(method="replay", seconds=1.0))
    assert len(read_scores(tmp_path)["replay"].cleaning) == 3
    # Another recording is added; the same one is measured again.
    again = [run | {"movement": name, "seed": 0} for name in ("stirring", "wiping")]
    for row in again:
        write_scores(tmp_path, MethodScores(method="replay", cleaning=[row]))
    assert read_scores(tmp_path)["replay"].cleaning == again
    for name in ("stirring", "wiping"):
        assert rows_of(tmp_path, f"benchmark_cleaning_{name}")["replay"][0] == "1 of 1"


def test_cleaning_says_how_the_recording_is_placed_and_which_one_is_used(tmp_path):
    values = np.column_stack([np.arange(300) / 20, 2.0 * ellipse(300, seed=1)])
    np.save(tmp_path / "rings.npy", np.stack([values, 0.5 * values]))
    messages = []
    movement = board_movement(tmp_path / "rings.npy", messages.append)
    assert "rings.npy: the first of 2 recordings" in messages
    placed_at = re.search(r"its plane, at (\d+) % of its size", "".join(messages))
    width = np.ptp(movement.parts[0][:, :2], axis=0).max()
    recorded = np.ptp(values[:, 1:3], axis=0).max()
    assert width / recorded == pytest.approx(int(placed_at[1]) / 100, abs=0.03)


@pytest.mark.usefixtures("few")
def test_cleaning_runs_of_other_settings_are_not_mixed(tmp_path, monkeypatch):
    cleaned = {name: 0.5 for name in ("seconds_to_50", "seconds_to_90", "cleaned")}
    monkeypatch.setattr(
        "fmp_drake.experiments.benchmark.cleaning.clean_board",
        lambda *_, **__: cleaned | dict.fromkeys(["seconds_to_99", "force_near"], 0.5),
    )

    def run(method, *, size=1.0, duration=5.0, seeds=2):
        write_recording(tmp_path, "ring", ellipse(300, seed=1, size=size))
        run_cleaning(
            tmp_path / "ring.npz",
            tmp_path,
            Here(),
            methods=[method],
            duration=duration,
            seeds=seeds,
            progress=lambda _: None,
        )

    run("still")
    run("replay")
    for other in ({"size": 0.9}, {"duration": 60.0}, {"seeds": 5}):
        with pytest.raises(ExperimentError, match=r"on ring that are of another"):
            run("still", **other)
    rows = read_scores(tmp_path)["still"].cleaning
    assert [(row["seed"], row["duration"]) for row in rows] == [(0, 5.0), (1, 5.0)]


def test_a_name_of_a_recording_is_no_markup(tmp_path):
    row = {"movement": '"<i>', "cycles": "4", "seed": 0, "duration": 5.0, "error": "x"}
    scores = {"replay": MethodScores(method="replay", cleaning=[row])}
    write_benchmark(tmp_path, scores, folder=tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<i>" not in page
    assert 'id="benchmark_cleaning_&quot;&lt;i&gt;"' in page


@pytest.mark.parametrize(("cycles", "learned"), [(9, "4"), (3.9, "3"), (2.4, "1.5")])
def test_board_is_cleaned_after_at_most_four_cycles(cycles, learned):
    path = ellipse(round(cycles * PERIOD))
    movement = Movement(name="ring", parts=(path,), period=PERIOD)
    split = split_to_learn(movement)
    assert (split.cycles, split.place) == (learned, 0)


def test_recording_of_too_few_cycles_cleans_no_board():
    movement = Movement(name="ring", parts=(ellipse(70),), period=PERIOD)
    with pytest.raises(ExperimentError, match=r"ring has 1\.7 cycles on the board"):
        split_to_learn(movement)


def test_path_beyond_the_board_is_refused():
    far = ellipse(200) + np.array([0.3, 0.0, 0.0])
    with pytest.raises(DemonstrationError, match="leaves the board"):
        clean_board(far, (ellipse(200),), duration=1.0)


@pytest.mark.slow
def test_same_station_follows_a_path_and_measures_the_area_it_cleans():
    path = ellipse(200) * [1.0, 1.0, 0.0]
    half = path[:21]
    back = np.concatenate([half, half[::-1]])
    scores = clean_board(path, (path,), duration=4.0)
    # The edges of the felt clean less than its middle.
    assert scores["cleaned"] > 0.8
    assert 0.5 < scores["seconds_to_50"] < 2.5
    assert scores["tracking_rms_m"] < 0.01
    assert scores["force_near"] > 0.8
    partly = clean_board(np.concatenate([back, back, back]), (path,), duration=4.0)
    assert 0.3 < partly["cleaned"] < 0.75
    assert partly["seconds_to_90"] is None
