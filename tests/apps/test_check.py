"""Facts about `fmp-drake check`, and about what `fmp-drake wipe` refuses."""

import json
import re

import matplotlib.image
import numpy as np
import pytest

from fmp_drake.station import models_dir

FAR = "board:\n  translation: [0.80, 0.0, 0.10]\n"


@pytest.fixture
def far(tmp_path):
    """A scenario whose board is too far away."""
    path = tmp_path / "far.yaml"
    path.write_text(FAR, encoding="utf-8")
    return path


def test_feasible_skill_is_reported_and_drawn(command, outputs):
    plot, report = outputs / "reach.png", outputs / "figures.json"
    result = command("check", "--plot", plot, "--report", report)
    assert result.code == 0
    assert "The arm can follow this skill" in result.out
    assert matplotlib.image.imread(plot).shape[0] > 300
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["is_feasible"] is True
    assert figures["reachable_fraction"] == 1


def test_an_arm_without_joint_limits_has_no_margin_of_them(command, outputs):
    urdf = (models_dir() / "ur5e" / "ur5e.urdf").read_text()
    urdf = re.sub("<visual>.*?</visual>", "", urdf, flags=re.DOTALL)
    urdf = re.sub(' (lower|upper)="[^"]*"', "", urdf)
    (outputs / "ur5e.urdf").write_text(urdf.replace('"revolute"', '"continuous"'))
    robot, report = outputs / "ur5e.yaml", outputs / "check.json"
    robot.write_text((models_dir() / "ur5e" / "ur5e.yaml").read_text())
    result = command("check", "--robot", robot, "--report", report)
    assert "can follow this skill: it needs up to" in " ".join(result.out.split())

    def refuse(constant):  # JSON has neither infinity nor NaN.
        raise ValueError(constant)

    values = json.loads(report.read_text(), parse_constant=refuse)
    assert values["smallest_joint_margin"] is None


def test_infeasible_skill_ends_with_a_code_and_a_picture(command, outputs, far):
    plot = outputs / "reach.svg"
    result = command("check", "--scenario", far, "--plot", plot)
    assert result.code == 1
    assert "cm towards the arm" in " ".join(result.out.split())
    assert plot.stat().st_size > 0


def test_a_skill_that_leaves_its_demonstrations_is_reported(command, tmp_path):
    # Windows of two thirds of the only cycle.
    phase = 2 * np.pi * np.arange(24) / 23.5
    path = np.column_stack([0.05 * np.cos(phase), 0.09 * np.sin(phase), 0 * phase])
    recording = tmp_path / "lap.npz"
    np.savez(recording, time=np.arange(24) / 20, position=path)
    options = ("--window", 0.8, "--n-components", 10)  # Few: a mixture.
    out = command("check", "--demo", recording, *options).out
    assert "the playback leaves the demonstrated range (" in " ".join(out.split())


def test_start_that_is_out_of_reach_cannot_be_followed(command):
    result = command("check", "--start", 5, 0, 0)
    assert result.code == 1
    assert "the start is out of reach" in " ".join(result.out.split())


def test_wiping_an_infeasible_skill_is_refused_unless_forced(command, refused, far):
    run = ("wipe", "--headless", "--duration", 0.05, "--scenario", far)
    assert "--force" in refused(*run)
    forced = command(*run, "--force")
    assert forced.code == 0
    assert "cannot follow" in forced.out


def test_where_only_a_setting_helps_no_command_is_advised(command, refused, tmp_path):
    slow = tmp_path / "slow.yaml"
    slow.write_text("impedance: {max_torque_rate: 80.0}\n", encoding="utf-8")
    out = " ".join(command("check", "--scenario", slow).out.split())
    assert out.endswith("if the arm accepts it.")
    error = " ".join(refused("wipe", "--headless", "--scenario", slow).split())
    assert error.endswith("if the arm accepts it. (--force runs it anyway).")


def test_arm_holds_still_at_tempo_zero(command, tmp_path, outputs):
    path, report = tmp_path / "still.yaml", outputs / "report.json"
    path.write_text("skill: {tempo: 0}\nstart: [0.0, 0.0, 0.1]\n", encoding="utf-8")
    result = command(
        *("wipe", "--headless", "--duration", 0.3),
        *("--scenario", path, "--report", report),
    )
    assert result.code == 0
    metrics = json.loads(report.read_text(encoding="utf-8"))
    assert metrics["tracking_max_m"] < 1e-3
    assert metrics["remap_count"] == 0
