"""Facts about `fmp-drake learn`."""

import re
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import recorded_files

from fmp_drake.primitives import load_skill

REPOSITORY = Path(__file__).resolve().parents[2]


def test_skill_and_picture_are_written(command, make_npz, outputs):
    skill, plot = outputs / "skill.npz", outputs / "skill.png"
    result = command("learn", make_npz(), "--out", skill, "--plot", plot)
    assert result.code == 0
    assert result.err == ""
    assert f"wrote {skill}" in result.out
    assert f"wrote {plot}" in result.out
    learned = load_skill(skill)
    assert learned.n_steps == 120
    assert learned.channels_ == ("x", "y", "z")
    assert learned.frame_ == "board"
    assert np.ptp(matplotlib.image.imread(plot)[..., :3]) > 0.9
    assert len(list(outputs.iterdir())) == 2


def test_poses_are_played_where_the_tool_moves_freely(command, outputs):
    skill = outputs / "skill.npz"
    stirring = REPOSITORY / "models" / "demonstrations" / "stirring.npz"
    result = command("learn", stirring, "--out", skill, "--n-components", 30)
    assert f"next: fmp-drake wipe --scenario stir --skill {skill}" in result.out


def test_a_scenario_for_poses_in_the_frame_of_the_base_is_printed(command, outputs):
    angle = np.arange(0, 60, 0.05)
    path = [0.5, 0.1, 0.3] + 0.06 * np.column_stack(
        [np.cos(angle), np.sin(angle), 0 * angle]
    )
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (len(angle), 1))
    header = "time,x,y,z,qx,qy,qz,qw"
    mine = table(outputs / "mine.csv", angle, path, quaternions, header=header)
    options = ("--extra", "orientation", "--out", outputs / "skill.npz")
    printed = command("learn", mine, "--as-recorded", *options).out
    free = outputs / "free.yaml"
    free.write_text(printed[printed.index("  board:") :], encoding="utf-8")
    assert "start: [0.5, 0.1, 0.3]" in free.read_text(encoding="utf-8")
    assert command("check", "--scenario", free).code == 0


def test_parts_that_a_fitted_surface_leaves_out_are_named(command, outputs):
    time, idle = np.arange(0, 18, 0.02), np.zeros((50, 2))
    few, many = 2 * np.pi * time[:300] / 1.5, 2 * np.pi * time[:500] / 2.5
    circles = 0.05 * np.column_stack([np.cos(few), np.sin(few)]) - [0.08, 0.0]
    eights = np.column_stack([0.05 * np.sin(2 * many), 0.1 * np.sin(many)])
    plane = np.concatenate([circles, circles[-1] + idle, eights, idle])
    path = np.column_stack([plane, 0 * plane[:, 0]])
    mine = table(outputs / "mine.csv", time, path, header="time,x,y,z")
    options = ("--surface", "plane", "--out", outputs / "skill.npz")
    printed = command("learn", mine, *options).out
    assert re.search(r"left out: another movement, 0\.0 to [67]\.\d s", printed)
    assert "there are two movements: one of them is left out" in printed
    assert printed.count("left out:") == 1


def test_bouts_on_a_surface_that_are_another_movement_are_named(command, outputs):
    time = np.arange(0, 12, 0.02)
    fast, slow = 2 * np.pi * time[:300] / 1.5, 2 * np.pi * time / 2.5
    circles = 0.05 * np.column_stack([np.cos(fast), np.sin(fast), 0 * fast])
    eights = np.column_stack([0.05 * np.sin(2 * slow), 0.1 * np.sin(slow), 0 * slow])
    files = [
        table(outputs / name, time[: len(path)], path, header="time,x,y,z")
        for name, path in (("circles.csv", circles), ("eights.csv", eights))
    ]
    options = ("--surface", "plane", "--out", outputs / "skill.npz")
    printed = " ".join(command("learn", *files, *options).out.split())
    assert "left out: another movement, 0.0 to 6.0 s of bout 1 (bouts" in printed


def test_next_command_names_the_robot_of_the_recording(command, make_npz, outputs):
    skill = outputs / "skill.npz"
    result = command("learn", make_npz(), "--robot", "ur5e", "--out", skill)
    last = result.out.splitlines()[-1]
    assert last == f"next: fmp-drake wipe --robot ur5e --skill {skill}"


def test_fitted_board_that_is_not_written_is_said_to_be_lost(
    command, make_npz, outputs
):
    files = ("--out", outputs / "skill.npz")
    alone = command("learn", make_npz(), "--surface", "plane", *files)
    assert alone.code == 0, alone
    assert "the fitted board is not in the skill" in alone.out
    assert "next:" not in alone.out
    board = outputs / "board.yaml"
    both = command("learn", make_npz(), "--surface", "plane", *files, "--board", board)
    assert f"next: fmp-drake wipe --scenario {board}" in both.out
    assert "not in the skill" not in both.out


def test_options_set_window_and_components(command, make_npz, outputs):
    skill = outputs / "skill.npz"
    options = ("--window", 2.0, "--n-components", 3)
    assert command("learn", make_npz(), "--out", skill, *options).code == 0
    learned = load_skill(skill)
    assert learned.n_steps == 40
    assert len(learned.components_) <= 3


def test_model_is_chosen_and_reported(command, make_npz, outputs):
    skill = outputs / "skill.npz"
    output = {}
    for model in ("mixture", "phase"):
        result = command("learn", make_npz(), "--out", skill, "--model", model)
        assert result.code == 0
        assert load_skill(skill).model_ == model
        output[model] = " ".join(result.out.split())
    assert "model: mixture, because it was requested" in output["mixture"]
    assert f"cycles of {load_skill(skill).period_:.2f} s" in output["phase"]
    assert "cycles" in output["phase"]


def test_stretch_slows_the_skill_down(command, make_npz, outputs):
    demo = make_npz()
    windows = []
    for factor in (1, 2):
        skill = outputs / f"{factor}.npz"
        options = ("--stretch", factor, "--n-components", 3)
        assert command("learn", demo, "--out", skill, *options).code == 0
        windows.append(load_skill(skill).n_windows_)
    # 20 s against 40 s, less a window of 6 s, every half second.
    assert windows[1] > 2 * windows[0]


def test_times_of_a_part_are_those_of_the_recording_before_it_is_stretched(
    command, tmp_path, outputs
):
    time = np.arange(0, 40, 0.05)
    radius, rate = np.where(
        time < 20, [[0.05], [2 * np.pi / 2]], [[0.1], [2 * np.pi / 4]]
    )
    path = radius * [np.cos(rate * time), np.sin(rate * time), 0 * time]
    demo, skill = tmp_path / "two.npz", outputs / "skill.npz"
    np.savez(demo, time=time, position=path.T)
    call = ("learn", demo, "--out", skill, "--from", 20, "--to", 40, "--stretch", 2)
    for period in ((), ("--period", 4)):
        assert command(*call, *period).code == 0
        learned = load_skill(skill)
        assert learned.period_ == pytest.approx(8, rel=0.01)
        assert np.ptp(learned.extent_[:, 0]) == pytest.approx(0.2, abs=0.01)


def test_the_recording_is_not_replaced_by_its_skill(refused, make_npz):
    demo = make_npz()
    before = demo.read_bytes()
    assert "is the recording" in refused("learn", demo, "--out", demo)
    assert demo.read_bytes() == before
    assert "must end in .npz" in refused(
        "learn", demo, "--out", demo.with_suffix(".csv")
    )


def test_a_recording_that_is_learned_as_it_is_is_not_placed(refused, make_npz, outputs):
    call = ("learn", make_npz(), "--out", outputs / "skill.npz", "--as-recorded")
    assert "--as-recorded places nothing" in refused(*call, "--surface", "plane")
    wanted = (
        "--extra force needs force, or force_x, force_y, force_z: name their columns"
    )
    assert wanted in refused(*call, "--extra", "force")
    angles = table(outputs / "q.csv", np.arange(30) / 20, np.ones(30), header="time,q1")
    advice = "--extra adds to x, y and z, which are not among them. Leave it out"
    assert advice in refused("learn", angles, *call[2:], "--extra", "force")
    assert "leave out --board" in refused(*call, "--board", "b.yaml")
    assert "leave out --robot" in refused(*call, "--robot", "ur5e")
    board = ("learn", call[1], "--out", "s.npz", "--board")
    for name in ("s.npz", "car"):
        assert "must end in .yaml or .yml" in refused(*board, name)


def test_several_files_are_learned_together(command, make_npz, outputs):
    paths = [make_npz("one.npz"), make_npz("two.npz")]
    counts = []
    for files in (paths[:1], paths):
        skill = outputs / "skill.npz"
        options = ("--out", skill, "--n-components", 3)
        assert command("learn", *files, *options).code == 0
        counts.append(load_skill(skill).n_windows_)
    assert counts[1] == 2 * counts[0]


def test_same_file_gives_the_same_skill(
    command, make_npz, outputs, learned_once, monkeypatch
):
    monkeypatch.setattr(learned_once, "is_on", False)
    demo = make_npz()
    skills = []
    for name in ("one.npz", "two.npz"):
        assert command("learn", demo, "--out", outputs / name).code == 0
        skills.append(load_skill(outputs / name))
    for one, two in zip(*(s.components_ for s in skills), strict=True):
        assert np.array_equal(one.mean, two.mean)


def test_failed_learning_keeps_the_older_skill(command, refused, make_npz, outputs):
    skill = outputs / "skill.npz"
    options = ("--out", skill, "--n-components", 3)
    assert command("learn", make_npz(), *options).code == 0
    before = skill.read_bytes()
    refused("learn", make_npz("short.npz", seconds=1), "--out", skill)
    assert skill.read_bytes() == before


def test_demonstration_and_output_are_required(refused, make_npz):
    assert "DEMONSTRATIONS" in refused("learn", "--out", "skill.npz")
    assert "--out" in refused("learn", make_npz())


# Whatever the recording looks like -------------------------------------------


def table(path, *columns, header):
    np.savetxt(
        path, np.column_stack(columns), delimiter=",", header=header, comments=""
    )
    return path


def circles(seconds=20):
    time = np.arange(0, seconds, 0.05)
    path = [0.08 * np.cos(3 * time), 0.12 * np.sin(3 * time), 0 * time]
    return time, np.column_stack(path)


def test_units_that_cannot_be_right_are_refused_with_a_guess(command, refused, outputs):
    time, path = circles()
    right = table(outputs / "m.csv", time, path, header="time,x,y,z")
    wrong = table(outputs / "mm.csv", time, 1e3 * path, header="time,x,y,z")
    skill = outputs / "skill.npz"
    message = refused("learn", wrong, "--out", skill)
    assert "the path is 240 m wide: millimetres? Give --unit mm" in message
    learned = []
    for options in ((right,), (wrong, "--unit", "mm")):
        assert command("learn", *options, "--n-components", 3, "--out", skill).code == 0
        learned.append(load_skill(skill).components_[0].mean)
    np.testing.assert_allclose(*learned, atol=1e-9)


def test_recorded_poses_are_learned_for_free_space(
    command, outputs, real_demonstration_paths
):
    out = outputs / "skill.npz"
    path, options = (
        real_demonstration_paths["car_rim_4"],
        ("--as-recorded", "--out", out),
    )
    command("learn", path, *options, "--extra", "orientation")
    skill = load_skill(out)
    assert skill.channels_ == ("x", "y", "z", "rx", "ry", "rz")
    assert skill.model_ == "phase"
    command("check", "--scenario", "stir", "--skill", out)


def test_a_force_in_a_file_of_its_own_is_learned_like_one_in_the_same_file(
    command, outputs, real_demonstration_paths
):
    skill = outputs / "skill.npz"
    with np.load(real_demonstration_paths["car_rim_1"]) as arrays:
        time, path, newtons = (arrays[n] for n in ("time", "position", "force"))
    stamps = time + 1.7e9
    place = table(outputs / "pose.csv", stamps, path, header="time,x,y,z")
    force = table(outputs / "force.csv", stamps, newtons, header="time,fx,fy,fz")
    header = "time,x,y,z,fx,fy,fz"
    both = table(outputs / "both.csv", stamps, path, newtons, header=header)
    learned = []
    for files in ((place, force), (both,)):
        options = ("--surface", "fitted", "--extra", "force", "--out", skill)
        assert command("learn", *files, *options).code == 0
        learned.append(load_skill(skill))
    assert learned[0].channels_ == ("x", "y", "z", "force")
    np.testing.assert_allclose(*(s.components_[0].mean for s in learned), atol=1e-6)
    plain = command("learn", place, force, "--out", skill).out
    assert "force.csv left out: it is learned with --surface fitted --extra" in plain
    reported = command("inspect", force, place).out
    assert f"{place}: force_x, force_y, force_z of force.csv interpolated" in reported
    assert "channels: x, y, z (m); force_x, force_y, force_z (N)" in reported
    command("learn", force, place, "--as-recorded", "--extra", "force", "--out", skill)
    assert load_skill(skill).channels_[3:] == ("force_x", "force_y", "force_z")


def test_path_implausible_for_the_board_is_refused_and_learned_as_recorded(
    command, refused, outputs
):
    time, path = circles()
    ball = 0.2 * np.sin(np.outer(time, [3.0, 2.3, 5.1]) + np.arange(3))
    tumbling = table(outputs / "tumbling.csv", time, ball, header="time,x,y,z")
    large = table(outputs / "large.csv", time, 12 * path, header="time,x,y,z")
    skill = outputs / "skill.npz"
    for file, reason in (
        (tumbling, r"would touch it only \d+ % of the time; at least 20 %"),
        (large, "at 19 % of its size; at least 30 %"),
    ):
        message = refused("learn", file, "--out", skill)
        assert re.search(reason, message)
        assert "--as-recorded" in message
        options = ("--as-recorded", "--n-components", 3, "--out", skill)
        assert command("learn", file, *options).code == 0
        assert load_skill(skill).frame_ == ""


def test_channels_of_any_kind_are_learned_but_not_for_wiping(command, refused, outputs):
    time, path = circles()
    file = table(outputs / "d.csv", time, path[:, :2], header="t,force_x,pitch [deg]")
    skill = outputs / "skill.npz"
    result = command("learn", file, "--n-components", 3, "--out", skill)
    assert result.code == 0
    assert "d.csv: as recorded: without x, y and z there is no board" in result.out
    assert load_skill(skill).channels_ == ("force_x", "pitch")
    assert load_skill(skill).units_ == ("N", "rad")
    message = refused("wipe", "--headless", "--demo", file)
    assert "the channels are force_x, pitch; the board needs x, y and z" in message


def test_a_panda_s_joints_are_learned_as_the_path_of_the_eraser(command, outputs):
    time, path = circles()
    joints = [0, -0.8, 0, -2.3, 0, 1.6, 0.8] + path[:, [0, 1, 0, 1, 0, 1, 0]]
    names = [f"panda_joint{i}" for i in range(1, 8)]
    file = table(outputs / "d.csv", time, joints, header=",".join(["time", *names]))
    skill = outputs / "skill.npz"
    options = ("--transform", 0, 0, 0, 0, 0, 0, "--n-components", 3, "--out", skill)
    result = command("learn", file, *options)
    assert result.code == 0, result
    assert "by the forward kinematics of panda, from panda_joint1" in result.out
    assert load_skill(skill).channels_ == ("x", "y", "z")


@pytest.mark.parametrize("make", [recorded_files.letter, recorded_files.counted_time])
@pytest.mark.parametrize("command_line", [("inspect",), ("learn", "--out", "s.npz")])
def test_files_that_cannot_be_read_are_refused_in_one_line(
    refused, tmp_path, make, command_line
):
    assert "d." in refused(*command_line, make(tmp_path).path)
