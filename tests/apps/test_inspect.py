"""Facts about `fmp-drake inspect`."""

import re
import shlex

import matplotlib.image
import numpy as np
import pytest
import recorded_files as files

from fmp_drake import Demonstration
from fmp_drake.primitives.data.channels import FORCE_COMPONENTS


def test_five_lines_and_a_picture_describe_a_recording(command, make_npz, outputs):
    plot = outputs / "d.png"
    result = command("inspect", make_npz(seconds=30), "--plot", plot)
    assert result.code == 0
    first, channels, rate, cycles, learning, wrote, _ = result.out.splitlines()
    assert first.endswith("circles.npz: no remarks")
    assert channels == "  channels: x, y, z (m)"
    assert rate == "  rate: 20 Hz, 600 samples in 29.9 s"
    count, period = re.search(r"([\d.]+) cycles of ([\d.]+) s", cycles).groups()
    assert float(count) == pytest.approx(15, abs=0.1)
    assert float(period) == pytest.approx(2, rel=0.01)
    assert "possible, from 15.0 cycles; placed in the middle" in learning
    assert "it touches the board 100 % of the time" in learning
    assert wrote == f"wrote {plot}"
    assert np.ptp(matplotlib.image.imread(plot)[..., :3]) > 0.5


def test_options_for_arrays_that_are_left_out_are_named(command, make_npz):
    time = np.arange(0, 20, 0.05)
    path = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time), 0 * time])
    arrays = {"time": time, "position": path, "force": np.full((len(time), 3), 4.0)}
    out = command("inspect", make_npz("forces.npz", **arrays)).out
    assert "force left out" in out
    assert "\n  to learn more of it: --surface fitted --extra force\n" in out
    del arrays["force"]
    assert "to learn more" not in command("inspect", make_npz("bare.npz", **arrays)).out


def test_cycles_of_several_recordings_are_those_of_their_paths(command, tmp_path):
    paths = []
    for name, slope in (("a.csv", 1.0), ("b.csv", 3.0)):
        drift = slope * files.TIME
        text = files.lines(
            files.TIME, *files.PATH.T, drift, header="time,x,y,z,temperature"
        )
        paths.append(files.write(tmp_path, text, name).path)
    out = command("inspect", *paths).out
    assert "together: " in out
    assert "drifts" not in out


def test_a_saved_force_beside_a_position_hides_none_of_them(command, tmp_path):
    time, saved = files.TIME, tmp_path / "force.npz"
    force = Demonstration(
        time=time, values=files.FORCE, channels=FORCE_COMPONENTS, units=("N",) * 3
    )
    force.save(saved)
    out = command("inspect", saved, files.write(tmp_path, files.xyz()).path).out
    assert re.search(r"force.npz: .*\n  channels: force_x, force_y, force_z", out)
    assert re.search(r"csv: .*\n  channels: x, y, z \(m\)", out)


def test_gaps_are_reported_and_not_bridged(command, make_npz):
    time = np.r_[0:10:0.05, 12:20:0.05]
    path = make_npz("gap.npz", time=time, position=np.column_stack([np.sin(time)] * 3))
    report = command("inspect", path).out
    assert "gaps of more than 0.5 s, not bridged: 1" in report
    assert "learning: possible" in report


def test_reasons_against_learning_are_reported(command, make_npz, tmp_path):
    short = command("inspect", make_npz("short.npz", seconds=1.2)).out
    assert "cycles: none found" in short
    assert "Record at least" in short
    file = files.write(tmp_path, files.xyz(path=1e3 * files.PATH, header="t,x,y,z"))
    assert "not for the board: the path is 400 m wide: millimetres?" in (
        command("inspect", file.path).out
    )


def test_options_complete_the_file(command, tmp_path):
    file = files.columns_by_name(tmp_path)
    result = command("inspect", file.path, "--columns", file.options["columns"])
    assert "the time is in ms" in result.out
    assert "channels: x, y, z (m)" in result.out


def test_dataset_is_reported_by_episode(command, tmp_path):
    result = command("inspect", files.lerobot_3(tmp_path).path)
    assert "episode 0" in result.out
    assert "episode 1" in result.out


def joints_of_a_ur5e(folder):
    names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    angles = [0, -1.6, 1.9, -1.8, -1.6, 0] + 0.1 * np.sin(
        np.outer(3 * files.TIME, np.ones(6)) + np.arange(6)
    )
    header = ",".join(["time", *(f"{name}_joint" for name in names)])
    return files.write(folder, files.lines(files.TIME, *angles.T, header=header))


def in_millimetres(folder):
    return files.write(folder, files.xyz(path=1e3 * files.PATH, header="t,x,y,z"))


@pytest.mark.parametrize(
    "make",
    [
        files.plain,
        files.columns_by_name,
        in_millimetres,
        joints_of_a_ur5e,
        files.lerobot_without_names,
    ],
    ids=["plain", "columns", "millimetres", "UR5e", "joints without names"],
)
def test_the_next_command_learns_the_recording(command, make, tmp_path):
    file = make(tmp_path)
    flags = [x for name, value in file.options.items() for x in (f"--{name}", value)]
    report = command("inspect", file.path, *flags).out
    line = report.rpartition("next: fmp-drake ")[2].strip()
    words = shlex.split(line.replace("skill.npz", str(tmp_path / "skill.npz")))
    assert words[:2] == ["learn", str(file.path)]
    learned = command(*words, "--n-components", 3)
    assert learned.code == 0, learned.err
    assert (tmp_path / "skill.npz").is_file()


def test_a_wrist_that_turns_in_place_has_cycles_with_its_orientation(command, tmp_path):
    time = np.arange(0, 20, 0.02)
    half = 0.25 * np.sin(2 * np.pi * time / 2.5)
    columns = {"time": time, "x": 0.5 + 2e-4 * time, "y": 1e-4 * time**1.5}
    columns |= {"z": 0.3 - 1e-4 * time, "qx": 0 * time, "qy": 0 * time}
    columns |= {"qz": np.sin(half), "qw": np.cos(half)}
    path, table = tmp_path / "wrist.csv", np.column_stack([*columns.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
    text = command("inspect", path).out
    assert "cycles: none found" in text
    assert "With its orientation it has 8.0 cycles of 2.50 s" in text
    assert "--as-recorded --extra orientation" in text
