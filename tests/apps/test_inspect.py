"""Facts about `fmp-drake inspect`."""

import matplotlib.image
import numpy as np
import recorded_files as files


def test_five_lines_and_a_picture_tell_what_is_in_a_recording(
    command, make_npz, outputs
):
    plot = outputs / "d.png"
    result = command("inspect", make_npz(seconds=30), "--plot", plot)
    assert result.code == 0
    first, channels, rate, cycles, learning, wrote = result.out.splitlines()
    assert first.endswith("circles.npz: as it is")
    assert channels == "  channels: x, y, z (m)"
    assert "20 Hz, 600 samples in 29.9 s; intervals from 50 to 50 ms" in rate
    assert "15.0 of 2.00 s" in cycles
    assert "possible, from 241 windows of 6 s; laid onto the middle" in learning
    assert "it touches the board 100 % of the time" in learning
    assert wrote == f"wrote {plot}"
    assert np.ptp(matplotlib.image.imread(plot)[..., :3]) > 0.5


def test_reasons_against_learning_are_said(command, make_npz, tmp_path):
    gap = np.r_[0:10:0.05, 12:20:0.05]
    path = make_npz("gap.npz", time=gap, position=np.zeros((len(gap), 3)))
    assert "not possible: there is a gap of 2.05 s" in command("inspect", path).out
    short = command("inspect", make_npz("short.npz", seconds=2)).out
    assert "cycles: none found" in short
    assert "Record at least" in short
    file = files.write(tmp_path, files.xyz(path=1e3 * files.PATH, header="t,x,y,z"))
    assert "not for the board: the path is 400 m wide: millimetres?" in (
        command("inspect", file.path).out
    )


def test_options_say_what_the_file_does_not(command, tmp_path):
    file = files.columns_by_name(tmp_path)
    result = command("inspect", file.path, "--columns", file.options["columns"])
    assert "the time is in ms" in result.out
    assert "channels: x, y, z (m)" in result.out


def test_a_dataset_is_told_of_by_episodes(command, tmp_path):
    result = command("inspect", files.lerobot_3(tmp_path).path)
    assert "episode 0" in result.out
    assert "episode 1" in result.out
