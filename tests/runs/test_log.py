"""Facts about logs of runs."""

import json
from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest

from fmp_drake.errors import RunError
from fmp_drake.runs.log import (
    SIGNALS,
    RunLog,
    Signal,
    TemporaryArray,
    current_versions,
    signal_kind,
    skill_signals,
    write_log,
)


@pytest.fixture
def signals():
    """Times and values of three signals, two of them sampled together."""
    fast, slow = np.arange(50) / 1000, np.arange(5) / 100
    rng = np.random.default_rng(0)
    return {
        "measured_position": (fast, rng.normal(size=(50, 3))),
        "torque": (fast, rng.normal(size=(50, 7))),
        "normal_force": (slow, rng.normal(size=(5, 1))),
    }


@pytest.fixture
def path(signals, tmp_path):
    """A log of them."""
    path = tmp_path / "run.npz"
    write(path, signals)
    return path


def write(path, signals):
    write_log(
        path,
        signals,
        scenario="board:\n  rpy: [0, 0, 0]\n",
        seed=3,
        metrics={"cleaned_fraction": 0.5},
    )


def test_loaded_log_equals_the_saved_one(signals, path):
    assert [p.name for p in path.parent.iterdir()] == ["run.npz"]
    log = RunLog.load(path)
    assert list(log.signals) == list(signals)
    for name, (times, values) in signals.items():
        np.testing.assert_array_equal(log[name].times, times)
        np.testing.assert_array_equal(log[name].values, values)
        described = SIGNALS[name].metadata(values.shape[1])
        for about in ("unit", "frame", "meaning"):
            assert getattr(log[name], about) == described[about]
        assert log[name].columns == tuple(described["columns"])
    assert log.scenario == "board:\n  rpy: [0, 0, 0]\n"
    assert log.seed == 3
    assert log.metrics == {"cleaned_fraction": 0.5}
    assert log.versions == current_versions()
    assert log["measured_position"].unit == "m"
    assert log["measured_position"].frame == "B"


def test_a_log_names_its_signals(path):
    log = RunLog.load(path)
    assert repr(log) == "<RunLog: measured_position, torque, normal_force>"
    assert list(log) == ["measured_position", "torque", "normal_force"]
    assert ("torque" in log, "ink" in log, 0 in log) == (True, False, False)


def test_a_signal_is_described_without_its_numbers(path):
    log = RunLog.load(path)
    assert repr(log["measured_position"]) == (
        "<Signal: 50 samples from 0 to 0.049 s, 3 columns in m: x, y, z>"
    )
    assert repr(log["normal_force"]) == (
        "<Signal: 5 samples from 0 to 0.04 s, 1 column in N: force>"
    )
    empty = Signal(times=np.zeros(0), values=np.zeros((0, 2)))
    assert repr(empty) == "<Signal: 0 samples, 2 columns>"


def test_a_log_from_temporary_files_is_the_same(signals, path, tmp_path):
    spills = {}
    for array in {id(a): a for pair in signals.values() for a in pair}.values():
        spills[id(array)] = TemporaryArray(array.shape[1:])
        for part in np.array_split(array, 3):
            spills[id(array)].append(part)
    arrays = {key: spill.array() for key, spill in spills.items()}
    spilled = {n: (arrays[id(t)], arrays[id(v)]) for n, (t, v) in signals.items()}
    write(tmp_path / "spilled.npz", spilled)
    with np.load(path) as one, np.load(tmp_path / "spilled.npz") as other:
        assert one.files == other.files
        for name in one.files:
            np.testing.assert_array_equal(one[name], other[name])


def test_a_log_is_read_without_the_package_and_shares_its_times(signals, path):
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
    np.testing.assert_array_equal(times, signals["normal_force"][0])


def test_version_of_a_missing_package_is_unknown(monkeypatch):
    def version(package):
        if package == "drake":
            raise PackageNotFoundError(package)
        return "2.0"

    monkeypatch.setattr("fmp_drake.runs.log.version", version)
    versions = current_versions()
    assert (versions["drake"], versions["numpy"]) == ("unknown", "2.0")


def test_a_signal_that_is_not_there_is_named(path):
    with pytest.raises(RunError, match="no signal 'ink'; it has measured_position"):
        RunLog.load(path)["ink"]


def test_missing_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(RunError, match="there is no log"):
        RunLog.load(tmp_path / "nowhere.npz")
    noise = tmp_path / "noise.npz"
    noise.write_bytes(b"noise")
    with pytest.raises(RunError, match="not a readable"):
        RunLog.load(noise)
    foreign = tmp_path / "foreign.npz"
    for arrays in (
        {"x": np.zeros(3)},
        {"metadata": np.array("no JSON")},
        {"metadata": np.array('{"format": "fmp-drake-skill", "version": 1}')},
        {"metadata": np.array("[1]")},
    ):
        np.savez(foreign, **arrays)
        with pytest.raises(RunError, match="is not a log of fmp_drake"):
            RunLog.load(foreign)
    np.savez(foreign, metadata=np.array([{"format": 1}], dtype=object))
    with pytest.raises(RunError, match="not a readable"):
        RunLog.load(foreign)


def test_every_cut_of_a_log_is_refused(path):
    whole = path.read_bytes()
    for fraction in np.linspace(0, 0.999, 25):
        path.write_bytes(whole[: int(fraction * len(whole))])
        with pytest.raises(RunError):
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
        (lambda about, _: about.update(version="x"), "is not a log"),
        (lambda about, _: about.pop("seed"), "incomplete"),
        (lambda about, _: about.update(signals=3), "incomplete"),
        (lambda _, arrays: arrays.pop("torque"), "incomplete"),
        (lambda _, arrays: arrays.pop("time_1"), "incomplete"),
        (lambda _, arrays: arrays.update(time_1=np.zeros(4)), r"expected \(N,\)"),
        (lambda _, arrays: arrays.update(time_1=np.arange(5)), "other than numbers"),
        (lambda _, arrays: arrays.update(torque=np.full((50, 7), "x")), "numbers"),
    ],
)
def test_newer_and_incomplete_logs_are_refused(change, match, path):
    rewritten(path, change)
    with pytest.raises(RunError, match=match):
        RunLog.load(path)


@pytest.mark.parametrize(
    ("times", "values", "match"),
    [
        ([0.0, 1.0], np.zeros((3, 2)), "times are"),
        ([0.0, 1.0], np.zeros((2, 3)), "2 names are given for 3 columns"),
        ([1.0, 0.0], np.zeros((2, 2)), "not ascending"),
        ([0.0, np.nan], np.zeros((2, 2)), "not finite"),
    ],
)
def test_signals_that_do_not_fit_are_refused(times, values, match):
    with pytest.raises(RunError, match=match):
        Signal(times=np.array(times), values=values, columns=("x", "y"))


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(
        RunError, match="no signal 'speed'; a log may contain desired_pos"
    ):
        signal_kind("speed")


def test_every_signal_has_a_meaning_and_a_unit_for_its_columns():
    for name, kind in SIGNALS.items():
        assert kind.meaning, name
        assert kind.frame in ("", "B", "T", "W")
        units = kind.unit.split(",")
        assert len(units) in (1, len(kind.columns)), name
        assert len(set(kind.columns)) == len(kind.columns)


@pytest.mark.parametrize("joints", [6, 7])
def test_columns_of_joints_are_as_many_as_the_arm_has(joints):
    torque = SIGNALS["torque"].metadata(joints)
    assert torque["columns"] == [f"joint{i + 1}" for i in range(joints)]
    assert torque["unit"] == "N m"
    state = SIGNALS["state"].metadata(2 * joints)
    assert state["unit"] == ",".join(joints * ["rad"] + joints * ["rad/s"])
    assert state["columns"] == [
        *(f"joint{i + 1}" for i in range(joints)),
        *(f"joint{i + 1}_velocity" for i in range(joints)),
    ]


def test_a_log_that_cannot_be_written_is_an_error(signals, tmp_path):
    with pytest.raises(RunError, match="cannot write"):
        write(tmp_path / "no" / "run.npz", signals)
    folder = tmp_path / "folder.npz"
    folder.mkdir()
    with pytest.raises(RunError, match="cannot write"):
        write(folder, signals)
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("row", [(), (3,), (2, 2)])
def test_rows_come_back_whole(row):
    rows = np.random.default_rng(0).normal(size=(500_000 // int(np.prod(row)), *row))
    spill = TemporaryArray(row)
    for part in np.array_split(rows, 7):
        spill.append(part)
    assert spill.shape == rows.shape
    np.testing.assert_array_equal(spill.array(), rows)


def test_values_read_before_an_append_are_unchanged():
    spill = TemporaryArray((2,), np.uint8)
    assert spill.array().shape == (0, 2)
    spill.append([[1, 2]])
    first = spill.array()
    spill.append([[3, 4], [5, 6]])
    np.testing.assert_array_equal(first, [[1, 2]])
    assert spill.array().dtype == np.uint8
    np.testing.assert_array_equal(spill.array()[1:], [[3, 4], [5, 6]])
    array = spill.array()
    del spill
    assert array.sum() == 21


def test_the_file_has_no_name(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    spill = TemporaryArray()
    spill.append(np.ones(10**6))
    assert spill.shape == (10**6,)
    assert list(tmp_path.iterdir()) == []


def test_signals_over_a_curved_surface_say_what_they_are():
    flat, curved = (
        skill_signals(["x", "y", "z"], ["m"] * 3, weights=10, is_curved=is_curved)
        for is_curved in (False, True)
    )
    assert flat == SIGNALS
    assert curved["measured_position"].meaning == "(u, v, h)"
    assert (flat["tracking_error"].frame, curved["tracking_error"].frame) == ("B", "T")
    assert curved["measured_velocity"].frame == "T"
    assert curved["torque"] == flat["torque"]
