"""Facts about runs of skills with orientation and force, at a board and in free space."""

import numpy as np
import pytest
from posed_recordings import demonstration
from pydrake.geometry import Meshcat, MeshcatParams

from fmp_drake.apps.run_report import report_rows
from fmp_drake.errors import RunError, SkillError, StationError
from fmp_drake.film import FilmReel, film_run
from fmp_drake.film.render import FILM_SIGNALS
from fmp_drake.film.scene import renders
from fmp_drake.plots import plot_run
from fmp_drake.plots.run_page import RUN_PAGE_SIGNALS
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.runs import MakeRun, RunLog, WipingRun
from fmp_drake.station import CheckFeasibility, MakeStation, Scenario

pytestmark = pytest.mark.slow
CLOCKS = {"simulated_seconds": 1.0, "wall_seconds": 1.0, "real_time_factor": 1.0}


@pytest.fixture(scope="module")
def stirring():
    return FourierMovementPrimitive(n_components=30).fit(
        demonstration(height=0.15, tilt=0.4)
    )


@pytest.fixture(scope="module")
def free():
    scenario = Scenario()
    scenario.board.shape = "none"
    scenario.impedance.rotational_stiffness = [60.0, 60.0, 60.0]
    scenario.start = [0.06, 0.0, 0.15]
    return scenario


@pytest.fixture(scope="module")
def stirred(free, stirring):
    """Three seconds of stirring in free space, with everything that a run can write."""
    run = MakeRun(
        free,
        stirring,
        meshcat=Meshcat(MeshcatParams(host="localhost")),
        recording=True,
        keep={
            *("covariance", "weights", "measured_pose", "desired_orientation"),
            *RUN_PAGE_SIGNALS,
            *FILM_SIGNALS,
        },
    )
    reel = FilmReel(run.station, fps=2.0)
    run.simulator.set_monitor(reel.observe)
    run.advance_to(3.0)
    return run, reel


def rows_of(run):
    events = [event._asdict() for event in run.events()]
    return report_rows({**CLOCKS, **run.metrics(), "events": events})


def test_free_space_is_measured_in_metres_and_degrees_only(stirred):
    run, _ = stirred
    assert not isinstance(run, WipingRun)
    metrics = run.metrics()
    assert not [n for n in metrics if "force" in n or "clean" in n or "board" in n]
    assert metrics["tracking_rms_m"] < 1.5e-3
    assert 0.01 < metrics["orientation_rms_deg"] < 0.5
    assert metrics["orientation_rms_deg"] < metrics["orientation_max_deg"] < 1.0
    assert run.events() == []


def test_orientation_error_is_that_of_the_poses(stirred):
    run, _ = stirred
    q = run.log("measured_pose")[:, :4]
    desired_orientation = run.log("desired_orientation")
    angle = 2 * np.arccos(
        np.clip(np.abs(np.sum(q * desired_orientation, axis=1)), 0, 1)
    )
    rms = np.rad2deg(np.sqrt(np.mean(angle**2)))
    assert run.metrics()["orientation_rms_deg"] == pytest.approx(rms, rel=0.01)


def test_the_table_of_free_space_contains_degrees_and_no_ink(stirred):
    rows = rows_of(stirred[0])
    assert {"cleaned", "time to clean", "normal force", "surface"}.isdisjoint(rows)
    assert "degrees rms" in rows["tracking error"]
    assert rows["what went wrong"] == "nothing"


def test_an_arm_without_joint_limits_has_no_nearest_one(stirred):
    metrics = {**CLOCKS, **stirred[0].metrics(), "events": []}
    metrics["joint_limit_margin_min_rad"] = np.inf
    assert report_rows(metrics)["limits"].endswith("nearest joint limit none")


def test_the_log_names_the_channels_of_the_skill(stirred, tmp_path):
    run, _ = stirred
    run.save_log(tmp_path / "run.npz", {})
    log = RunLog.load(tmp_path / "run.npz")
    assert "ink" not in log.signals
    assert log["covariance"].columns[:4] == ("xx", "yx", "zx", "rxx")
    assert log["covariance"].unit.split(",")[3] == "rad m"
    assert len(log["weights"].unit.split(",")) == log["weights"].values.shape[1]
    assert log["measured_pose"].values.shape[1] == 7


def test_picture_film_and_replay_of_free_space(stirred, tmp_path):
    run, reel = stirred
    plot_run(run, tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 20_000
    page = run.html(title="stirring")
    assert "path of the tool" in page
    assert "force on the eraser" not in page
    assert reel.ink.shape == (len(reel.times), 0)
    if renders():
        film_run(run, reel, tmp_path / "run.gif", width=160)
        assert (tmp_path / "run.gif").stat().st_size > 2_000


def test_a_force_channel_is_measured_against_the_force_of_the_moment():
    skill = FourierMovementPrimitive(n_components=30).fit(
        demonstration(height=-0.002, force=(10.0, 4.0))
    )
    scenario = Scenario()
    scenario.start = [0.06, 0.0, 0.0]
    scenario.impedance.force_control.enabled = True
    assert CheckFeasibility(scenario, skill).is_feasible
    run = MakeRun(scenario, skill, keep=("desired_normal_force",))
    assert isinstance(run, WipingRun)
    run.advance_to(4.0)
    metrics = run.metrics()
    assert np.ptp(run.log("desired_normal_force")) > 6.0
    assert 0 < metrics["normal_force_error_rms_n"] < 1.0
    assert metrics["normal_force_wanted_fraction"] > 0.95
    assert "N rms" in rows_of(run)["tracking error"]


def test_check_follows_the_poses_of_a_skill_in_free_space(free, stirring):
    feasibility = CheckFeasibility(free, stirring)
    assert feasibility.is_feasible, feasibility.verdict
    assert feasibility.values["largest_angle"] < 0.02
    assert "largest_press" not in feasibility.values
    leaning = FourierMovementPrimitive(n_components=30).fit(
        demonstration(height=0.15, tilt=1.4)
    )
    refused = CheckFeasibility(free, leaning)
    assert not refused.is_feasible


def test_a_run_that_wipes_needs_a_board_and_names_the_one_that_does_not(free, stirring):
    with pytest.raises(RunError, match=r"no board to wipe; MakeRun\(scenario, skill\)"):
        WipingRun(free, stirring)


@pytest.mark.parametrize("use", [MakeRun, CheckFeasibility, MakeStation])
def test_the_name_of_a_scenario_is_not_a_scenario(small_skill, use):
    with pytest.raises(
        StationError, match=r"a scenario, such as .*; it is 'table_top'"
    ):
        use("table_top", small_skill)


@pytest.mark.parametrize("use", [MakeRun, CheckFeasibility])
def test_a_scenario_alone_has_no_skill_to_run_or_check(use):
    with pytest.raises(SkillError, match=r"needs a skill, .*; it is None"):
        use(Scenario(), None)
