"""Facts about logs of runs."""

import json

import numpy as np
import pytest

from fmp_drake.errors import FmpError
from fmp_drake.runs.log import RunLog, Signal, check_log, current_versions
from fmp_drake.runs.signals import SIGNALS, signal_kind


@pytest.fixture
def log():
    fast, slow = np.arange(50) / 1000, np.arange(5) / 100
    rng = np.random.default_rng(0)
    return RunLog(
        signals={
            "measured_position": Signal.named(
                "measured_position", fast, rng.normal(size=(50, 3))
            ),
            "torque": Signal.named("torque", fast.copy(), rng.normal(size=(50, 7))),
            "normal_force": Signal.named("normal_force", slow, rng.normal(size=5)),
        },
        scenario="board:\n  rpy: [0, 0, 0]\n",
        seed=3,
        figures={"cleaned_fraction": 0.5},
    )


def test_a_log_comes_back_as_it_was(log, tmp_path):
    path = tmp_path / "run.npz"
    log.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]
    again = RunLog.load(path)
    assert list(again.signals) == list(log.signals)
    for name, signal in log.signals.items():
        np.testing.assert_array_equal(again[name].times, signal.times)
        np.testing.assert_array_equal(again[name].values, signal.values)
        for about in ("unit", "frame", "meaning", "columns"):
            assert getattr(again[name], about) == getattr(signal, about)
    assert again.scenario == log.scenario
    assert again.seed == 3
    assert again.figures == {"cleaned_fraction": 0.5}
    assert again.versions == current_versions()
    assert again["measured_position"].unit == "m"
    assert again["measured_position"].frame == "B"
    assert again["normal_force"].values.shape == (5, 1)


def test_a_log_is_read_without_the_package_and_shares_its_times(log, tmp_path):
    path = tmp_path / "run.npz"
    log.save(path)
    with np.load(path, allow_pickle=False) as file:
        assert sorted(file.files) == [
            "measured_position",
            "metadata",
            "normal_force",
            "time_0",
            "time_1",
            "torque",
        ]
        about = json.loads(str(file["metadata"]))
        assert about["signals"]["torque"]["times"] == "time_0"
        assert about["signals"]["measured_position"]["times"] == "time_0"
        times = file[about["signals"]["normal_force"]["times"]]
    np.testing.assert_array_equal(times, log["normal_force"].times)


def test_a_signal_that_is_not_there_is_named(log):
    with pytest.raises(FmpError, match="no signal 'ink'; it has measured_position"):
        log["ink"]


def test_missing_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(FmpError, match="there is no log"):
        RunLog.load(tmp_path / "nowhere.npz")
    noise = tmp_path / "noise.npz"
    noise.write_bytes(b"noise")
    with pytest.raises(FmpError, match="not a readable"):
        RunLog.load(noise)
    foreign = tmp_path / "foreign.npz"
    for arrays in (
        {"x": np.zeros(3)},
        {"metadata": np.array("no JSON")},
        {"metadata": np.array('{"format": "fmp-drake-skill", "version": 1}')},
        {"metadata": np.array("[1]")},
    ):
        np.savez(foreign, **arrays)
        with pytest.raises(FmpError, match="is no log of a run"):
            RunLog.load(foreign)
    np.savez(foreign, metadata=np.array([{"format": 1}], dtype=object))
    with pytest.raises(FmpError, match="not a readable"):
        RunLog.load(foreign)


def test_every_cut_of_a_log_is_refused(log, tmp_path):
    path = tmp_path / "run.npz"
    log.save(path)
    whole = path.read_bytes()
    for share in np.linspace(0, 0.999, 25):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FmpError):
            RunLog.load(path)


def rewritten(path, change):
    """Change the metadata and arrays of a log."""
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["metadata"]))
    change(about, arrays)
    arrays["metadata"] = np.array(json.dumps(about))
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda about, _: about.update(version=2), "has version 2"),
        (lambda about, _: about.update(version="x"), "is no log"),
        (lambda about, _: about.pop("seed"), "incomplete"),
        (lambda about, _: about.update(signals=3), "incomplete"),
        (lambda _, arrays: arrays.pop("torque"), "incomplete"),
        (lambda _, arrays: arrays.pop("time_1"), "incomplete"),
        (lambda _, arrays: arrays.update(time_1=np.zeros(4)), r"expected \(N,\)"),
        (lambda _, arrays: arrays.update(time_1=np.arange(5)), "other than numbers"),
        (lambda _, arrays: arrays.update(torque=np.full((50, 7), "x")), "numbers"),
    ],
)
def test_newer_and_incomplete_logs_are_refused(change, match, log, tmp_path):
    path = tmp_path / "run.npz"
    log.save(path)
    rewritten(path, change)
    with pytest.raises(FmpError, match=match):
        RunLog.load(path)


@pytest.mark.parametrize(
    ("times", "values", "match"),
    [
        ([0.0, 1.0], np.zeros((3, 3)), "signal torque: times are"),
        ([0.0, 1.0], np.zeros((2, 6)), "7 names are given for 6 columns"),
        ([1.0, 0.0], np.zeros((2, 7)), "not ascending"),
        ([0.0, np.nan], np.zeros((2, 7)), "not finite"),
    ],
)
def test_signals_that_do_not_fit_are_refused(times, values, match):
    with pytest.raises(FmpError, match=match):
        Signal.named("torque", times, values)


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(FmpError, match="no signal 'speed'; a log may hold desired_pos"):
        signal_kind("speed")


def test_every_signal_has_a_meaning_and_a_unit_for_its_columns():
    for name, kind in SIGNALS.items():
        assert kind.meaning, name
        assert kind.frame in ("", "B", "W")
        units = kind.unit.split(",")
        assert len(units) in (1, len(kind.columns)), name
        assert len(set(kind.columns)) == len(kind.columns)


def test_a_log_that_cannot_be_written_is_an_error_and_keeps_the_older(log, tmp_path):
    with pytest.raises(FmpError, match="cannot write"):
        log.save(tmp_path / "no" / "run.npz")
    folder = tmp_path / "folder.npz"
    folder.mkdir()
    with pytest.raises(FmpError, match="cannot write"):
        log.save(folder)
    assert list(tmp_path.iterdir()) == [folder]


def test_names_that_cannot_be_written_are_refused_before(tmp_path):
    check_log(None)
    check_log(tmp_path / "run.npz")
    with pytest.raises(FmpError, match=r"end in \.npz"):
        check_log(tmp_path / "run.csv")
    with pytest.raises(FmpError, match="there is no folder"):
        check_log(tmp_path / "no" / "run.npz")
