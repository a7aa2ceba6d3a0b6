"""Facts about the first seconds of every scenario that comes with the package.

models/scenarios/README.md tells of a minute of each.

One class for each scenario, so that `pytest -n auto --dist loadscope` spreads them.
"""

import json

import pytest

from fmp_drake.runs.station_run import MakeRun
from fmp_drake.skills.learning import scenario_skill
from fmp_drake.station.scenario import ListScenarios, LoadScenario
from fmp_drake.station.scenario_parts import FORCE_TOLERANCE

pytestmark = pytest.mark.slow

AFTER, APART = 0.5, 1.5


def metrics_of(name):
    """Return the metrics of a run as `fmp-drake wipe --headless` simulates it.

    Past a re-mapping, and until 1.5 s after the last disturbance. Between them are 1.5 s,
    too, less than in the scenarios.
    """
    scenario = LoadScenario(name)
    skill, demonstrations, _ = scenario_skill(scenario)
    end = APART
    for each in scenario.disturbances:
        each.start = end + APART
        end = each.start + each.duration
    run = MakeRun(scenario, skill, demonstrations=demonstrations)
    remapped = (skill.n_steps - skill.overlap) / skill.rate / scenario.skill.tempo
    run.advance_to(max(remapped + AFTER, end + APART))
    return run.metrics()


class Run:
    """Facts about every scenario."""

    @pytest.fixture(scope="class")
    @classmethod
    def metrics(cls):
        metrics = metrics_of(cls.scenario)
        # Shown where a test fails.
        print(cls.scenario, json.dumps(metrics, indent=1))  # noqa: T201
        return metrics

    def test_keeps_every_limit(self, metrics):
        assert 0 < metrics["torque_ratio_max"] < 1
        assert 0 < metrics["joint_speed_ratio_max"] < 1
        assert 0 < metrics["torque_rate_max_nm_per_s"] < 1000
        assert metrics["joint_limit_margin_min_rad"] > 0
        assert metrics["fault_fraction"] == 0

    def test_remaps_without_a_jump(self, metrics):
        assert metrics["remap_count"] >= 1
        assert metrics["desired_position_jump_max_m"] < 1e-4


class FreeRun(Run):
    """Facts about scenarios in free space."""

    def test_follows_positions_and_orientations(self, metrics):
        assert metrics["tracking_rms_m"] < 1.5e-3
        assert metrics["orientation_rms_deg"] < 0.6


class BoardRun(Run):
    """Facts about scenarios with a board."""

    def test_presses_as_desired_in_contact(self, metrics):
        assert FORCE_TOLERANCE == 5.0
        assert metrics["normal_force_wanted_fraction"] >= 0.95
        assert metrics["contact_fraction"] > 0.9

    def test_follows_the_force_of_the_moment(self, metrics):
        assert metrics.get("normal_force_error_rms_n", 0.0) < 0.5


class FixedBoardRun(BoardRun):
    """Facts about scenarios with a board at rest."""

    def test_cleans_most_of_the_demonstrated_area(self, metrics):
        assert metrics["cleaned_fraction_of_demonstrated_area"] >= 0.6


class OtherArmRun(FixedBoardRun):
    """What holds on the table top with another arm than the Panda, too."""

    def test_presses_within_a_newton_and_follows_to_four_millimetres(self, metrics):
        assert metrics["normal_force_p05_n"] > 9
        assert metrics["normal_force_p95_n"] < 11
        assert metrics["tracking_rms_m"] < 0.004


for _name in ListScenarios():
    _scenario = LoadScenario(_name)
    _kind = BoardRun if _scenario.board.motion.amplitude > 0 else FixedBoardRun
    _kind = FreeRun if _scenario.board.shape == "none" else _kind
    _kind = _kind if _scenario.robot == "panda" else OtherArmRun
    _class = f"Test_{_name}"
    globals()[_class] = type(_class, (_kind,), {"scenario": _name})
