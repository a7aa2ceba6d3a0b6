"""Facts about runs of the wiping station."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.common.yaml import yaml_load_typed

from fmp_drake.apps.page import open_page
from fmp_drake.errors import RunError
from fmp_drake.primitives import Demonstration
from fmp_drake.runs import RunLog, WipingRun
from fmp_drake.runs.log import SIGNALS
from fmp_drake.runs.simulation_loop import reset
from fmp_drake.skills import scenario_skill
from fmp_drake.station.scenario import LoadScenario, Scenario

KEPT = ("measured_position", "state", "weights")
# No multiple of a chunk, nor of the period of any signal but the fastest.
SECONDS = 1.237


@pytest.fixture(scope="module", params=["table_top", "cenic"])
def scenario(request):
    scenario = LoadScenario(request.param)
    scenario.start = [0.0, 0.0, 0.0]
    return scenario


@pytest.fixture(scope="module")
def whole(scenario, wiping_skill):
    """A run that is taken in at once."""
    run = WipingRun(scenario, wiping_skill, keep=KEPT)
    run.simulator.AdvanceTo(SECONDS)
    return run


@pytest.fixture(scope="module")
def parts(scenario, wiping_skill):
    """The same run in chunks, after another one that was reset."""
    run = WipingRun(scenario, wiping_skill, keep=KEPT)
    run.advance_to(0.3)
    reset(run.simulator)
    run.simulator.Initialize()
    run.restart()
    # At multiples of a millisecond, where the integrator stops anyway.
    for until in (0.1, 0.5, SECONDS):
        run.advance_to(until)
    return run


def test_metrics_do_not_depend_on_the_chunks(whole, parts):
    expected = whole.metrics()
    never = {name for name, value in expected.items() if value is None}
    assert parts.metrics() == {
        name: None if name in never else pytest.approx(value, rel=1e-9)
        for name, value in expected.items()
    }
    assert parts.metrics()["normal_force_mean_n"] > 5
    assert parts.metrics()["tracking_max_m"] > 0


def test_kept_signals_do_not_depend_on_the_chunks(whole, parts):
    for name in KEPT:
        assert_array_equal(parts.log(name), whole.log(name))
        assert_array_equal(parts.log_times(name), whole.log_times(name))
    times = parts.log_times("state")
    assert np.all(np.diff(times) > 0)
    assert times[0] == 0.0
    assert len(times) == 1238


def test_a_signal_that_was_not_kept_is_refused(whole):
    for get in (whole.log, whole.log_times):
        with pytest.raises(
            RunError, match=r"torque was not kept; .* measured_position,"
        ):
            get("torque")


def test_signals_to_keep_are_a_list(scenario, wiping_skill):
    with pytest.raises(RunError, match=r"keep is 'state'; .* \['state'\]"):
        WipingRun(scenario, wiping_skill, keep="state")


def test_a_run_that_was_not_recorded_has_no_page(whole):
    with pytest.raises(RunError, match="nothing was recorded; give the run a Meshcat"):
        whole.html()


def test_log_of_a_run_contains_its_kept_signals(parts, tmp_path):
    parts.save_log(tmp_path / "run.npz", {"tempo": 1.0})
    log = RunLog.load(tmp_path / "run.npz")
    at_the_end = {n for n, kind in SIGNALS.items() if not np.isfinite(kind.period)}
    assert set(log.signals) == {*KEPT, *at_the_end}
    for name in KEPT:
        assert_array_equal(log[name].values, parts.log(name))
        assert_array_equal(log[name].times, parts.log_times(name))
    assert_array_equal(log["ink"].values[0], parts.output("ink"))
    assert log.metrics == {"tempo": 1.0}
    assert yaml_load_typed(schema=Scenario, data=log.scenario).start == [0.0, 0.0, 0.0]


def test_cells_without_ink_are_not_to_be_cleaned(whole, monkeypatch):
    ink = np.array(whole.initial_ink)
    empty = np.flatnonzero(whole.demonstrated_area)[:50]
    ink.flat[empty] = 0.0
    erased = np.full(whole.grid.shape, np.inf)
    erased.flat[empty] = 0.5
    monkeypatch.setattr(whole, "initial_ink", ink)
    monkeypatch.setattr(whole, "erase_time", lambda: erased)
    assert whole.cleaned_by([9.0]) == [0.0]


def test_cells_of_the_demonstrated_area_are_cleaned_one_after_the_other(
    whole, monkeypatch
):
    area = whole.demonstrated_area
    erased = np.full(area.shape, 0.5)  # Beside the area, which does not count.
    erased[area] = 1.0 + np.arange(area.sum()) / area.sum()
    erased.flat[np.flatnonzero(area)[-1]] = np.inf
    monkeypatch.setattr(whole, "erase_time", lambda: erased)
    np.testing.assert_allclose(
        whole.cleaned_by([0.0, 0.9, 1.5, 9.0]),
        [0.0, 0.0, 0.5, 1.0 - 1.0 / area.sum()],
        atol=1.1 / area.sum(),
    )


def test_force_is_compared_with_what_the_page_asks_for(wiping_skill):
    panel = open_page(None)
    run = WipingRun(
        LoadScenario("table_top"),
        wiping_skill,
        meshcat=panel.meshcat,
        panel=panel,
        keep=["normal_force", "desired_normal_force"],
    )
    run.simulator.Initialize()
    panel.meshcat.SetSliderValue("press force (N)", 3.0)
    run.advance_to(4.0)
    assert run.desired_force()[-1] == panel.shown["desired_force"] == 3
    assert run.log("normal_force")[-100:].mean() == pytest.approx(3, abs=1)
    assert run.metrics()["normal_force_wanted_fraction"] > 0.98
    panel.close()


def test_the_page_shows_the_force_that_the_skill_desires():
    scenario = LoadScenario("pulsing_force")
    skill, demonstrations, _ = scenario_skill(scenario)
    panel = open_page(None)
    run = WipingRun(
        scenario,
        skill,
        demonstrations=demonstrations,
        meshcat=panel.meshcat,
        panel=panel,
        keep=["desired_normal_force"],
    )
    for until in (0.5, 1.0, 1.5):
        run.advance_to(until)
        latest = run.desired_force()[-30:]
        assert np.min(np.abs(latest - panel.shown["desired_force"])) < 0.05
    assert np.ptp(run.desired_force()) > 2
    panel.close()


def test_only_what_was_learned_counts_as_the_demonstrated_area(wiping_skill):
    # From far outside, where the eraser never wipes.
    path = wiping_skill.paths_[0][:, :3]
    border = np.linspace([-0.3, -0.3, 0.0], path[0], 100)
    shown = Demonstration(
        time=np.arange(100 + len(path)) / 20, values=np.vstack([border, path])
    )
    panel = open_page(None)
    run = WipingRun(
        LoadScenario("table_top"),
        wiping_skill,
        demonstrations=[shown],
        meshcat=panel.meshcat,
        panel=panel,
    )
    footprint = run.scenario.board_footprint()
    expected = run.grid.swept_by([path], footprint)
    assert_array_equal(run.demonstrated_area, expected)
    run.advance_to(3.0)
    cleaned = run.metrics()["cleaned_fraction_of_demonstrated_area"]
    assert panel.shown["cleaned"] == pytest.approx(cleaned, abs=0.02)
    panel.close()
