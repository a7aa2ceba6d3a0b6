"""Facts about recordings of real robots: they play within limits, or are refused with a reason."""

import json

import pytest

NAMES = (
    "panda_mixing_pan",
    "panda_wiping_big_board_2_loop",
    "panda_wiping_loop",
    "panda_wiping_loop_increase_z_1",
    "panda_wiping_loop_increase_z_2",
    "panda_wiping_loop_increase_z_3",
    "panda_wiping_loop_increase_z_4",
)


@pytest.mark.parametrize("name", NAMES)
def test_recording_plays_within_limits_as_it_is_or_as_advised(
    command, outputs, real_demonstration_paths, name
):
    if name not in real_demonstration_paths:
        pytest.skip(f"there is no recording {name}")
    path, report = real_demonstration_paths[name], outputs / "report.json"
    arguments = ("wipe", "--headless", "--duration", 3, "--demo", path)
    result = command(*arguments, "--report", report)
    if result.code != 0:
        # One or two cycles at a nominal speed are too short for the default window.
        assert result.code == 2
        assert result.err.count("\n") == 1
        assert "--stretch" in result.err
        assert not report.exists()
        result = command(*arguments, "--report", report, "--stretch", 4)
        assert result.code == 0, result
    assert f"{path.name}: placed in the middle of the board" in result.out
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["torque_ratio_max"] < 1
    assert figures["torque_rate_max_nm_per_s"] < 1000
    assert figures["joint_limit_margin_min_rad"] > 0
    assert figures["joint_speed_ratio_max"] < 1
    assert figures["tracking_rms_m"] < 0.03
