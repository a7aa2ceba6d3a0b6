import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from fmp_drake.apps import reproduce as reproduce_module
from fmp_drake.apps.reproduce import compare_recordings
from fmp_drake.errors import ExperimentError, FmpError
from fmp_drake.experiments.finding import Closeness, Finding, roughness
from fmp_drake.experiments.held_out import evaluate, held_out_finding, summary
from fmp_drake.experiments.methods import (
    FMP,
    FMP_PAPER,
    GP,
    MULT,
    MULT_OWN,
    PHASE,
    REPLAY,
    compared,
)
from fmp_drake.experiments.metrics import divergences, grid_extent
from fmp_drake.experiments.profile import QUICK
from fmp_drake.experiments.report import write_report
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

    from fmp_drake.apps.main import app

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


def write_recordings(folder, **counts):
    """Write recordings of polishing, each of so many samples at 20 Hz."""
    for i, (name, count) in enumerate(counts.items()):
        path = HandMotion.make("polishing", seconds=11, seed=i).position[:2000:10]
        np.savez(
            folder / f"{name}.npz",
            time=np.arange(count) / 20,
            position=np.column_stack([path, 1e-4 * np.sin(np.arange(200))])[:count],
        )


def test_recordings_of_one_movement_are_held_out_in_turn(tmp_path, monkeypatch):
    write_recordings(tmp_path, loop_1=200, loop_2=200, loop_3=200, short=100)
    few = {name: compared()[name] for name in (PHASE, FMP, FMP_PAPER, REPLAY, GP)}
    monkeypatch.setattr("fmp_drake.experiments.held_out.compared", lambda: few)
    told = []
    small = replace(QUICK, samples=50, predictions=5)
    (_, findings), results = compare_recordings(tmp_path, small, told.append)
    assert [f.name for f in findings] == ["held_out_loop"]
    assert any("short lasts" in each for each in told)
    scores = results["loop"]
    assert scores[PHASE]["prediction_rms"]["mean"] < 0.03 * 1e3
    assert "tube_10" in scores[GP]


class Shy:
    """A method that learns from nothing."""

    def fit(self, _):
        raise ExperimentError("there are no periods")


@pytest.fixture
def quick_and_shy(monkeypatch):
    """Let two methods be compared only: one that is quick, and one that never learns."""
    few = {MULT: compared()[MULT], "shy": (lambda _: Shy(), 2)}
    monkeypatch.setattr("fmp_drake.experiments.held_out.compared", lambda: few)


@pytest.mark.usefixtures("quick_and_shy")
def test_what_is_too_short_or_cannot_be_learned_has_no_scores(tmp_path):
    write_recordings(tmp_path, loop_1=200, loop_2=200, loop_3=30)
    recordings = [Demonstration.load(path) for path in sorted(tmp_path.iterdir())]
    told = []
    small = replace(QUICK, folds=3, samples=50, predictions=3)
    scores = evaluate(recordings, small, told.append)
    assert set(scores) == {MULT}
    assert len(scores[MULT]["prediction_rms"]) == 2 * QUICK.seeds
    said = "shy cannot learn from the rest: there are no periods"
    assert told.count(said) == 2


@pytest.mark.usefixtures("quick_and_shy")
@pytest.mark.parametrize("terminal", [False, True])
def test_a_folder_of_recordings_is_a_section_of_the_report(
    command, tmp_path, monkeypatch, terminal
):
    if terminal:  # One that shows no bar either.
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("TERM", "dumb")
    # Stands in for a minute of the paper's experiments.
    monkeypatch.setattr(
        reproduce_module, "run_experiments", lambda *_: ([], {"held_out": {}})
    )
    folder, out = tmp_path / "mine", tmp_path / "out"
    folder.mkdir()
    write_recordings(folder, loop_1=200, loop_2=200)
    result = command("reproduce", "--quick", "--demos", folder, "--out", out)
    assert result.code == 0, result
    results = json.loads((out / "results.json").read_text())
    assert set(results["held_out"]["loop"]) == {MULT}
    assert "Held out: recordings in mine" in (out / "report.html").read_text()
    assert ("shy cannot learn" in result.out) != terminal
    assert f"wrote {out / 'report.html'}" in result.out.replace("\n", "")


def test_recordings_that_are_all_too_short_are_said_and_refused(tmp_path):
    write_recordings(tmp_path, loop_1=30, loop_2=30)
    told = []
    with pytest.raises(FmpError, match=r"has no \.npz recording of"):
        compare_recordings(tmp_path, QUICK, told.append)
    assert any("loop lasts 1.4 s: too short to learn from" in each for each in told)


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


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(FmpError, match=r"has no \.npz recording of 7\.5 s"):
        compare_recordings(tmp_path, QUICK, lambda _: None)


def test_report_escapes_what_it_prints(tmp_path):
    finding = Finding(name="a", title="<b>", shows="1 < 2", claim="x & y", agrees=False)
    write_report(
        tmp_path, sections=[("S", [finding])], introduction="", results={"a": 1}
    )
    page = (tmp_path / "report.html").read_text()
    assert "&lt;b&gt;" in page
    assert "1 &lt; 2" in page
    assert "x &amp; y" in page
