import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from trials_stub import Here

from fmp_drake.apps import reproduce as reproduce_module
from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.benchmark.built_in import ReplayMethod
from fmp_drake.experiments.held_out import evaluate, held_out_finding, summary
from fmp_drake.experiments.methods import (
    FMP,
    FMP_PAPER,
    MULT,
    MULT_OWN,
    PHASE,
    REPLAY,
    compared,
)
from fmp_drake.experiments.metrics import (
    Closeness,
    divergences,
    grid_extent,
    roughness,
)
from fmp_drake.experiments.report import QUICK, Finding, write_report
from fmp_drake.primitives import Demonstration
from fmp_drake.systems.teaching.hand_motion import HandMotion

pytestmark = pytest.mark.slow

FIGURES = (
    "fig3",
    "fig4",
    "fig5",
    "fig6",
    "fig7",
    "fig8",
    "fig9",
    "fig10",
    "fig10_robot",
    "sensitivity",
    "eight_played",
    "held_out_eight",
)


@pytest.fixture(scope="module")
def own_recording(tmp_path_factory):
    """30 s of a hand's eight in the y-z plane, without a frame."""
    path = HandMotion.make("eight", seconds=31, seed=5).position[:6000:10]
    values = np.column_stack([np.zeros(len(path)), path[:, 1], path[:, 0]])
    file = tmp_path_factory.mktemp("own") / "mine.npz"
    np.savez(file, time=np.arange(len(path)) / 20, position=values)
    return file


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory, own_recording):
    """The folder that a quick run writes, and what it prints."""
    from click.testing import CliRunner

    from fmp_drake.apps.commands import app

    out = tmp_path_factory.mktemp("reproduced") / "made" / "here"
    call = ["reproduce", "--quick", "--out", str(out), "--demo", str(own_recording)]
    result = CliRunner().invoke(app, call, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return out, result.output


def test_every_figure_and_the_numbers_are_written(reproduced):
    out, printed = reproduced
    names = {f"{name}.png" for name in FIGURES} | {"report.html", "results.json"}
    assert {p.name for p in out.iterdir()} == names
    assert "report.html" in printed
    assert "Table I" in printed


def test_results_hold_table_one_the_held_out_scores_and_the_settings(reproduced):
    results = json.loads((reproduced[0] / "results.json").read_text())
    for row in results["table1"].values():
        assert row["forward_kl"] > 0
        assert row["reverse_kl"] > 0
    assert set(results["table1"]) == {MULT, MULT_OWN, FMP_PAPER, FMP, PHASE, REPLAY}
    assert results["held_out"]["eight"][FMP]["log_density"]["mean"] > 10
    assert results["settings"]["samples"] == QUICK.samples
    assert results["settings"]["fmp"]["n_components"] == "automatic"
    assert set(results["demonstrations"]["mine"]) == set(results["table1"])


def test_table_one_compares_equals_and_names_what_was_only_remembered(reproduced):
    table = json.loads((reproduced[0] / "results.json").read_text())["table1"]
    for divergence in ("forward_kl", "reverse_kl"):
        # With the paper's settings for both there is little between them.
        ratio = table[FMP_PAPER][divergence] / table[MULT][divergence]
        assert 0.7 < ratio < 1.1
        assert table[PHASE][divergence] < table[MULT_OWN][divergence]
        assert table[REPLAY][divergence] < 0.1 * table[PHASE][divergence]


def test_held_out_the_phase_model_is_scored_beside_an_oracle(reproduced):
    scores = json.loads((reproduced[0] / "results.json").read_text())["held_out"]
    eight = scores["eight"]
    for measure in ("forward_kl", "prediction_rms", "tube_10"):
        assert measure in eight["oracle"]
    rivals = [MULT, MULT_OWN, REPLAY, FMP, FMP_PAPER]
    for rival in rivals:
        ours, theirs = (eight[n]["prediction_rms"]["mean"] for n in (PHASE, rival))
        assert ours < theirs
    assert eight[PHASE]["log_density"]["mean"] > eight[FMP]["log_density"]["mean"] + 2
    assert "tube_10" not in eight[REPLAY]


def test_claims_about_fmp_hold(reproduced):
    findings = json.loads((reproduced[0] / "results.json").read_text())["findings"]
    claims = ("fig4", "fig5", "fig6", "fig9", "fig10", "fig10_robot", "eight_played")
    for name in claims:
        assert findings[name]["agrees"], findings[name]["shows"]


def test_a_short_recording_teaches_the_phase_model_to_predict(reproduced):
    results = json.loads((reproduced[0] / "results.json").read_text())
    said = results["findings"]["short_eight"]["shows"]
    by_pieces, _ = (float(number) for number in re.findall(r"with ([\d.]+) mm", said))
    # What remembers two thirds of the recording.
    assert by_pieces < results["held_out"]["eight"][REPLAY]["prediction_rms"]["mean"]


def test_report_needs_nothing_but_itself(reproduced):
    page = (reproduced[0] / "report.html").read_text()
    sources = re.findall(r'src="([^"]{0,30})', page)
    assert len(sources) == len(FIGURES)
    assert all(s.startswith("data:image/png;base64,") for s in sources)
    # The letters of a picture in base64 may spell anything.
    assert "http" not in re.sub(r"data:image/png;base64,[\w+/=]*", "", page)
    assert "does not hold" in page


def test_divergences_of_the_demonstrations_themselves_are_zero():
    path = np.random.default_rng(0).random((50, 3))
    assert divergences(path, path, extent=grid_extent(path)) == (0.0, 0.0)


def test_closeness_is_the_distance_to_the_nearest_sample():
    near = Closeness(np.array([[0.0, 0.0], [1.0, 0.0]]))
    np.testing.assert_allclose(
        near.distances(np.array([[[0.0, 0.3], [0.9, 0.0]]])), [[0.3, 0.1]]
    )


def test_roughness_of_a_cubic_is_its_third_derivative():
    t = np.arange(0, 1, 0.01)
    assert roughness((t**3)[:, None], 100.0) == pytest.approx(6.0, rel=1e-6)


def test_held_out_scores_are_collected_over_parts_and_seeds():
    path = HandMotion.make("eight", seconds=46, seed=1).position[:9000:10]
    values = np.column_stack([path, 1e-4 * np.sin(np.arange(len(path)))])
    demonstration = Demonstration(time=np.arange(len(path)) / 20, values=values)
    told = []
    small = replace(QUICK, samples=100, predictions=3)
    scores = evaluate(demonstration, small, told.append)
    assert told
    assert len(scores[FMP]["log_density"]) == QUICK.folds * QUICK.seeds
    assert summary(scores)[FMP]["log_density"]["std"] == 0
    finding = held_out_finding("eight", scores)
    assert isinstance(finding.figure, Figure)
    assert finding.table[0][0] == ""
    assert {row[0] for row in finding.table[1:]} == set(scores)


def test_short_recordings_get_no_heatmap():
    path = HandMotion.make("polishing", seconds=61, seed=1).position[:12000:10]
    values = np.column_stack([path, 1e-4 * np.sin(np.arange(len(path)))])
    demonstration = Demonstration(time=np.arange(len(path)) / 20, values=values)
    small = replace(QUICK, samples=50, predictions=3)
    scores = evaluate(demonstration, small, lambda _: None)
    assert "forward_kl" not in scores[FMP]
    assert scores[PHASE]["prediction_rms"][0] > 0
    assert held_out_finding("polishing", scores).table


class Shy:
    """A method that learns from nothing."""

    def fit(self, _):
        raise ExperimentError("there are no periods")


def test_method_that_cannot_learn_has_no_scores(monkeypatch):
    few = {MULT: compared()[MULT], "shy": (lambda _: Shy(), 2)}
    monkeypatch.setattr("fmp_drake.experiments.held_out.compared", lambda: few)
    path = HandMotion.make("polishing", seconds=31, seed=1).position[:6000:10]
    values = np.column_stack([path, 1e-4 * np.sin(np.arange(len(path)))])
    demonstration = Demonstration(time=np.arange(len(path)) / 20, values=values)
    messages = []
    small = replace(QUICK, folds=2, samples=50, predictions=3)
    scores = evaluate(demonstration, small, messages.append)
    assert set(scores) == {MULT}
    assert len(scores[MULT]["prediction_rms"]) == 2 * QUICK.seeds
    message = "shy cannot learn from the rest: there are no periods"
    assert messages.count(message) == 2


@pytest.mark.parametrize("terminal", [False, True])
def test_benchmark_of_a_folder_is_a_section_of_the_report(
    command, tmp_path, monkeypatch, terminal
):
    if terminal:  # One without a progress bar.
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("TERM", "dumb")
    # Replaces a minute of the paper's experiments, and most methods.
    monkeypatch.setattr(
        reproduce_module, "run_experiments", lambda *_: ([], {"held_out": {}})
    )
    monkeypatch.setattr(reproduce_module, "LocalWorkers", lambda _: Here())
    monkeypatch.setattr("fmp_drake.experiments.benchmark.run.METHODS", (ReplayMethod,))
    folder, out = tmp_path / "mine", tmp_path / "out"
    folder.mkdir()
    phase = np.arange(300) / 6
    ring = 0.1 * np.column_stack([np.cos(phase), np.sin(phase), 0 * phase])
    np.savez(folder / "ring.npz", time=np.arange(300) / 20, position=ring)
    result = command("reproduce", "--quick", "--demos", folder, "--out", out)
    assert result.code == 0, result
    assert "Benchmark: recordings in mine" in (out / "report.html").read_text()
    assert json.loads((out / "method_replay.json").read_text())["predictions"]
    assert ("8.0 cycles" in result.out) != terminal
    assert f"wrote {out / 'report.html'}" in result.out.replace("\n", "")


@pytest.mark.parametrize("densities", [[-15.0, -9.0], [12.0, 14.0], [np.nan] * 2])
def test_every_bar_of_the_held_out_scores_is_seen(densities):
    scores = {
        name: {"log_density": [density], "prediction_rms": [3.0]}
        for name, density in zip((PHASE, FMP), densities, strict=True)
    }
    (axes, *_) = (
        each
        for each in held_out_finding("eight", scores).figure.axes
        if "densit" in each.get_xlabel()
    )
    low, high = axes.get_xlim()
    for density in filter(np.isfinite, densities):
        assert low < density < high


def test_report_escapes_what_it_prints(tmp_path):
    finding = Finding(name="a", title="<b>", shows="1 < 2", claim="x & y", agrees=False)
    write_report(
        tmp_path, sections=[("S", [finding])], introduction="", results={"a": 1}
    )
    page = (tmp_path / "report.html").read_text()
    assert "&lt;b&gt;" in page
    assert "1 &lt; 2" in page
    assert "x &amp; y" in page
