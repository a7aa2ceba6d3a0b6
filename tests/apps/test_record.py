"""Facts about `fmp-drake record`."""

import numpy as np
import pytest

from fmp_drake.primitives import Demonstration

pytestmark = pytest.mark.slow


def test_recording_is_a_demonstration_to_learn_from(command, outputs):
    path = outputs / "eight.npz"
    result = command("record", "--task", "eight", "--duration", 3, "--out", path)
    assert result.code == 0
    assert result.err == ""
    assert f"wrote {path}" in result.out
    recorded = Demonstration.load(path)
    assert recorded.duration == pytest.approx(3.0)
    assert recorded.is_uniform(20)
    assert recorded.frame == "board"
    assert "simulated" in recorded.note
    assert "eight" in recorded.note
    played = command(
        *("wipe", "--headless", "--duration", 0.2),
        *("--demo", path, "--window", 2, "--n-components", 2, "--force"),
    )
    assert played.code == 0
    assert "placed in" not in played.out


def test_recording_in_free_space_is_not_said_to_be_on_a_board(command, outputs):
    for scenario, task, is_on_board in (
        ("table_top", "eight", True),
        ("stir", "stirring", False),
    ):
        options = ("--duration", 0.6, "--out", outputs / f"{task}.npz")
        result = command("record", "--scenario", scenario, "--task", task, *options)
        assert result.code == 0
        assert (" on the board\n" in result.out) == is_on_board


def test_seed_determines_the_recording_and_the_name_its_format(command, outputs):
    recordings = {}
    for name, seed in (("a.npz", 3), ("b.csv", 3), ("c.npz", 4)):
        options = ("--duration", 0.6, "--seed", seed, "--out", outputs / name)
        assert command("record", *options).code == 0
        recordings[name] = Demonstration.load(outputs / name)
    one, table, other = recordings.values()
    assert np.array_equal(one.values, table.values)
    assert np.array_equal(one.time, table.time)
    assert not np.allclose(one.values, other.values, atol=0.005)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--duration", 0), "duration is 0"),
        (("--duration", -1), "duration is -1"),
        (("--duration", "nan"), "duration is nan"),
        (("--duration", "inf"), "duration is inf"),
        (("--duration", 0.006), "samples"),
        (("--duration", 36001), "duration is 36001.0 s; it must be at most 36000.0 s"),
        (("--minutes", 601), "duration is 36060.0 s; it must be at most 36000.0 s"),
        (("--seed", -1), "seed is -1"),
        (("--task", "dance"), "wiping"),
        (("--scenario", "billiards"), "table_top"),
        (("--spin",), "--spin"),
        (("--task", "stirring", "--out", "out.csv"), "reference of the rotation"),
    ],
)
def test_wrong_option_is_refused_in_one_line(refused, outputs, options, reason):
    short = ("--duration", 0.6, "--out", outputs / "out.npz")
    assert reason in refused("record", *short, *options)
    assert list(outputs.iterdir()) == []


def test_output_that_cannot_be_written_is_refused_before_the_work(refused, tmp_path):
    missing = tmp_path / "missing" / "out.npz"
    assert "there is no folder" in refused(
        "record", "--duration", 3600, "--out", missing
    )
    assert "--out" in refused("record")
