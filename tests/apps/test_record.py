"""Facts about `fmp-drake record`."""

import numpy as np
import pytest

from fmp_drake.primitives import Demonstration

pytestmark = pytest.mark.slow


def test_recording_is_a_demonstration_to_learn_from(command, outputs):
    path = outputs / "eight.npz"
    result = command("record", "--task", "eight", "--minutes", 0.05, "--out", path)
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
        *("--demo", path, "--window", 2, "--components", 2, "--force"),
    )
    assert played.code == 0
    assert "laid onto" not in played.out


def test_seed_determines_the_recording_and_the_name_its_format(command, outputs):
    recordings = {}
    for name, seed in (("a.npz", 3), ("b.csv", 3), ("c.npz", 4)):
        options = ("--minutes", 0.01, "--seed", seed, "--out", outputs / name)
        assert command("record", *options).code == 0
        recordings[name] = Demonstration.load(outputs / name)
    one, table, other = recordings.values()
    assert np.array_equal(one.values, table.values)
    assert np.array_equal(one.time, table.time)
    assert not np.allclose(one.values, other.values, atol=0.005)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--minutes", 0), "minutes is 0"),
        (("--minutes", -1), "minutes is -1"),
        (("--minutes", "nan"), "minutes is nan"),
        (("--minutes", "inf"), "minutes is inf"),
        (("--minutes", 0.0001), "samples"),
        (("--seed", -1), "seed is -1"),
        (("--task", "dance"), "wiping"),
        (("--scenario", "billiards"), "table_top"),
        (("--spin",), "--spin"),
    ],
)
def test_wrong_option_is_refused_in_one_line(refused, outputs, options, reason):
    short = ("--minutes", 0.01, "--out", outputs / "out.npz")
    assert reason in refused("record", *short, *options)
    assert list(outputs.iterdir()) == []


def test_output_that_cannot_be_written_is_refused_before_the_work(refused, tmp_path):
    missing = tmp_path / "missing" / "out.npz"
    assert "there is no folder" in refused("record", "--minutes", 60, "--out", missing)
    assert "--out" in refused("record")
