"""Facts about demonstrations and their files."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from fmp_drake.errors import DemonstrationError, FmpError, SkillFileError
from fmp_drake.primitives import Demonstration
from fmp_drake.primitives.data.demonstration import FORMAT
from fmp_drake.primitives.data.reading.table import ReadingOptions


def example(count=50, rate=20.0, **changes):
    time = np.arange(count) / rate
    values = np.column_stack([np.sin(time), np.cos(time), 0.1 * time])
    return Demonstration(**{"time": time, "values": values, **changes})


# Values -----------------------------------------------------------------


def test_one_channel_may_be_a_vector():
    demonstration = Demonstration(time=[0, 1, 2, 3], values=[4, 5, 6, 7])
    assert demonstration.values.shape == (4, 1)
    assert demonstration.channels == ("x",)
    assert demonstration.duration == 3


def test_channels_are_named_by_default():
    assert example().channels == ("x", "y", "z")
    assert example().units == ("m", "m", "m")
    four = Demonstration(time=np.arange(5), values=np.zeros((5, 4)))
    assert four.channels == ("c0", "c1", "c2", "c3")


def test_demonstration_is_an_immutable_copy():
    values = np.zeros((5, 3))
    demonstration = Demonstration(time=np.arange(5), values=values)
    values[0] = 1
    assert np.all(demonstration.values == 0)
    for array in (demonstration.time, demonstration.values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        demonstration.frame = "board"


@pytest.mark.parametrize(
    ("time", "values"),
    [
        (np.arange(5), np.zeros((4, 3))),
        (np.zeros((5, 1)), np.zeros((5, 3))),
        (np.arange(5), np.zeros((5, 3, 1))),
        (np.float64(1), np.zeros((5, 3))),
    ],
)
def test_wrong_shapes_are_refused(time, values):
    with pytest.raises(DemonstrationError, match=r"time has shape .* and values"):
        Demonstration(time=time, values=values)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_fewer_than_4_samples_are_refused(count):
    with pytest.raises(DemonstrationError, match=f"has {count} samples .* at least 4"):
        Demonstration(time=np.arange(count), values=np.zeros((count, 3)))


def test_no_channel_is_refused():
    with pytest.raises(DemonstrationError, match="of 0 channels"):
        Demonstration(time=np.arange(5), values=np.zeros((5, 0)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["time", "values"])
def test_numbers_that_are_not_finite_are_refused(where, bad):
    arrays = {"time": np.arange(9.0), "values": np.zeros((9, 2))}
    arrays[where][6] = bad
    with pytest.raises(DemonstrationError, match=f"{where} holds .* in sample 6"):
        Demonstration(**arrays)


@pytest.mark.parametrize("again", [3.0, 1.0])
def test_time_that_repeats_or_runs_back_is_refused(again):
    time = np.arange(9.0)
    time[4] = again
    with pytest.raises(DemonstrationError, match="does not increase after sample 3"):
        Demonstration(time=time, values=np.zeros((9, 2)))


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"channels": ("x", "y")}, "2 channel names and 3 units for 3 channels"),
        ({"units": ("m",)}, "3 channel names and 1 units"),
        ({"channels": ("x", "y", "x")}, "repeat"),
        ({"channels": ("x", "y", 3)}, r"channels is .*3\); expected one name per"),
        ({"units": "mmm"}, "units is 'mmm'; expected one name per channel"),
    ],
)
def test_names_and_units_must_fit(names, message):
    with pytest.raises(DemonstrationError, match=message):
        example(**names)


def test_select_takes_channels_in_order_with_their_units():
    force = example(channels=("x", "y", "f"), units=("m", "m", "N"), frame="board")
    selected = force.select(["f", "x"])
    assert selected.channels == ("f", "x")
    assert selected.units == ("N", "m")
    assert selected.frame == "board"
    assert np.array_equal(selected.values, force.values[:, [2, 0]])
    assert force.select("y").channels == ("y",)


def test_select_of_a_missing_channel_lists_those_that_are_there():
    with pytest.raises(DemonstrationError, match=r"no channel 'q'; .* x, y, z"):
        example().select(["x", "q"])


# Resampling -------------------------------------------------------------


def test_resampling_at_the_same_rate_returns_the_demonstration():
    demonstration = example(rate=20)
    assert demonstration.is_uniform(20)
    assert not demonstration.is_uniform(25)
    assert demonstration.resample(20) is demonstration


def test_resampling_filters_frequencies_above_the_new_rate():
    time = np.arange(0, 10, 0.01)
    sine = 0.1 * np.sin(2 * np.pi * 0.5 * time)
    noise = 0.01 * np.cos(2 * np.pi * 30 * time)
    clean = Demonstration(time=time, values=sine + noise).resample(20)
    assert_allclose(np.diff(clean.time), 0.05)
    expected = 0.1 * np.sin(2 * np.pi * 0.5 * clean.time)
    inside = slice(10, -10)
    assert_allclose(clean.values[inside, 0], expected[inside], atol=1e-4)
    # The padding of the filter keeps the first and the last sample as they are.
    assert_allclose(clean.values[:, 0], expected, atol=0.0101)
    # Without the filter it would appear at 10 Hz, in full.
    assert np.max(np.abs(noise[::5])) > 0.009


@settings(deadline=None, max_examples=20)
@given(rate=st.floats(15, 60), seed=st.integers(0, 100))
def test_irregular_times_are_interpolated(rate, seed):
    rng = np.random.default_rng(seed)
    time = 3.0 + np.cumsum(rng.uniform(0.02, 0.04, 200))
    values = np.column_stack([np.sin(3 * time), np.cos(2 * time)])
    even = Demonstration(time=time, values=values).resample(rate)
    assert even.time[0] == time[0]
    assert even.is_uniform(rate)
    assert time[-1] - time[0] - 1 / rate <= even.duration <= time[-1] - time[0] + 1e-6
    later = even.time
    expected = np.column_stack([np.sin(3 * later), np.cos(2 * later)])
    assert_allclose(even.values[3:-3], expected[3:-3], atol=5e-3)


def test_slow_recordings_are_interpolated_smoothly():
    slow = example(40, rate=5.0).resample(20)
    assert_allclose(slow.values[:, 0], np.sin(slow.time), atol=1e-4)
    assert slow.duration == pytest.approx(39 / 5)


def test_constant_channels_stay_constant():
    flat = Demonstration(time=np.arange(500) / 100, values=np.full((500, 2), 0.3))
    assert_allclose(flat.resample(20).values, 0.3, atol=1e-12)


def test_resampling_keeps_names_and_frame():
    demonstration = example(rate=50, channels=("a", "b", "c"), frame="board", note="n")
    resampled = demonstration.resample(20)
    assert resampled.channels == ("a", "b", "c")
    assert (resampled.frame, resampled.note) == ("board", "n")


def test_a_gap_is_refused_with_its_place():
    time = np.concatenate([np.arange(0, 5, 0.01), np.arange(7.25, 9, 0.01)])
    gap = Demonstration(time=time, values=np.zeros(len(time)))
    with pytest.raises(DemonstrationError, match=r"gap of 2\.26 s after 4\.99 s"):
        gap.resample(20)
    parts = gap.split_at_gaps(20)
    assert [len(part.resample(20).time) for part in parts] == [100, 35]
    assert parts[1].time[0] == 7.25


def circle(time):
    """Return positions on a circle of 0.1 m, shape (N, 2)."""
    return 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time)])


def resampling_error(time, noise=0.0, seed=0):
    """Return the greatest error of a resampled circle, m."""
    errors = np.random.default_rng(seed).normal(size=(len(time), 2))
    values = circle(time) + noise * errors
    resampled = Demonstration(time=time, values=values).resample(20)
    return np.abs(resampled.values - circle(resampled.time)).max()


@pytest.mark.parametrize(
    ("rate", "allowed"), [(25, 5e-3), (50, 2e-3), (100, 1e-3), (200, 2e-4)]
)
def test_a_late_time_stamp_hardly_moves_the_path(rate, allowed):
    time = np.arange(0, 40, 1 / rate)
    late = np.arange(2 * rate, len(time) - 2, 5 * rate)
    time[late] = time[late + 1] - 1e-4
    assert resampling_error(time) < allowed


def test_samples_that_arrive_in_bursts_are_resampled():
    samples = np.arange(2000)
    time = samples // 5 * 0.05 + samples % 5 * 1e-6
    # They arrive up to 40 ms late.
    values = circle(samples * 0.01)
    resampled = Demonstration(time=time, values=values).resample(20)
    expected = circle(resampled.time + 0.02)
    assert_allclose(resampled.values[2:-2], expected[2:-2], atol=2e-4)


@pytest.mark.parametrize("rate", [100, 240, 1000])
def test_noise_is_not_amplified_where_a_gap_is_bridged(rate):
    time = np.arange(0, 20, 1 / rate)
    time = time[(time < 7) | (time > 7.2)]
    assert resampling_error(time) < 2e-4
    errors = [resampling_error(time, noise=3e-4, seed=seed) for seed in range(9)]
    assert np.median(errors) < 2.2e-3


def test_a_fragment_between_gaps_does_not_hide_the_rest():
    time = np.arange(0, 40, 0.01)
    inside = (time > 20) & (time < 21.3)
    time = time[~inside | ((time > 20.6) & (time < 20.7))]
    recording = Demonstration(time=time, values=circle(time))
    parts = recording.split_at_gaps(20)
    assert [round(part.duration) for part in parts] == [20, 19]
    assert len(parts[0].resample(20).time) == 401
    # At a rate at which the fragment has 4 samples it is a part.
    assert len(recording.split_at_gaps(100)) == 3


@pytest.mark.parametrize("rate", [0.0, -20.0, np.nan, np.inf])
def test_rate_that_is_not_positive_is_refused(rate):
    with pytest.raises(DemonstrationError, match="rate is"):
        example().resample(rate)


def test_too_short_to_resample_is_refused():
    short = Demonstration(time=[0, 0.001, 0.002, 0.003], values=np.zeros(4))
    with pytest.raises(DemonstrationError, match="fewer than 2 samples"):
        short.resample(20)


def test_short_recordings_can_be_resampled():
    # Fewer samples than the padding of the filter.
    short = Demonstration(time=np.arange(20) / 200, values=np.zeros(20))
    with pytest.raises(DemonstrationError, match="2 samples of 1 channels"):
        short.resample(20)
    assert len(example(12, rate=100).resample(40).time) == 5


# Files ------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_file_round_trip_is_exact(tmp_path, suffix):
    saved = example(
        channels=("x", "force", "pitch angle"), units=("m", "N", "rad"), frame="board"
    )
    path = tmp_path / f"demonstration.{suffix}"
    saved.save(path)
    loaded = Demonstration.load(path)
    assert np.array_equal(loaded.time, saved.time)
    assert np.array_equal(loaded.values, saved.values)
    assert loaded.channels == saved.channels
    assert loaded.units == saved.units
    # A CSV has no place for the frame.
    assert loaded.frame == ("board" if suffix == "npz" else "")


def test_path_may_be_a_string(tmp_path):
    path = str(tmp_path / "d.npz")
    example().save(path)
    assert Demonstration.load(path).duration == example().duration


@pytest.mark.parametrize("name", ["d.txt", "d", "d.npz.bak"])
def test_a_file_of_another_ending_is_not_written(tmp_path, name):
    with pytest.raises(SkillFileError, match=r"ends with \.npz or \.csv"):
        example().save(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_saving_into_a_missing_folder_is_an_error(tmp_path, suffix):
    with pytest.raises(SkillFileError, match="cannot write"):
        example().save(tmp_path / "nowhere" / f"d.{suffix}")


def test_npz_of_another_program_needs_time_and_position(tmp_path):
    path = tmp_path / "d.npz"
    np.savez(path, time=np.arange(9.0), position=np.ones((9, 3)), extra=np.zeros(2))
    loaded = Demonstration.load(path)
    assert loaded.channels == ("x", "y", "z")
    assert np.all(loaded.values == 1)
    np.savez(path, position=np.ones((9, 3)), note="of someone")
    with pytest.raises(
        SkillFileError, match=r"no column holds the time; .* position_x"
    ):
        Demonstration.load(path)


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_missing_file_is_named(tmp_path, suffix):
    path = tmp_path / f"gone.{suffix}"
    with pytest.raises(SkillFileError, match=f"no demonstration file .*gone.{suffix}"):
        Demonstration.load(path)


@pytest.mark.parametrize("count", [0, 1])
def test_npz_with_too_few_samples_is_refused(tmp_path, count):
    path = tmp_path / "d.npz"
    np.savez(path, time=np.zeros(count), position=np.zeros((count, 3)))
    with pytest.raises(DemonstrationError, match=f"has {count} samples of 3 channels"):
        Demonstration.load(path)


def test_truncated_npz_is_refused(tmp_path):
    path = tmp_path / "d.npz"
    example().save(path)
    whole = path.read_bytes()
    for size in np.linspace(0, len(whole) - 1, 25).astype(int):
        path.write_bytes(whole[:size])
        with pytest.raises(SkillFileError, match=r"not a readable \.npz"):
            Demonstration.load(path)


def test_npz_with_any_byte_changed_is_refused_or_intact(tmp_path):
    saved, path = example(), tmp_path / "d.npz"
    saved.save(path)
    whole = path.read_bytes()
    for at in range(0, len(whole), 7):
        broken = bytearray(whole)
        broken[at] ^= 0xFF
        path.write_bytes(broken)
        try:
            loaded = Demonstration.load(path)
        except FmpError:
            continue
        assert np.array_equal(loaded.values, saved.values)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", b"\x93NUMPY\x01"])
def test_foreign_bytes_are_refused(tmp_path, content):
    path = tmp_path / "d.npz"
    path.write_bytes(content)
    with pytest.raises(SkillFileError, match=r"not a readable \.np[zy]"):
        Demonstration.load(path)


def test_single_array_needs_a_rate(tmp_path):
    path = tmp_path / "d.npz"
    with path.open("wb") as stream:
        np.save(stream, np.zeros((5, 3)))
    with pytest.raises(SkillFileError, match=r"3 columns have no names; .* rate"):
        Demonstration.load(path)
    loaded = Demonstration.load(path, ReadingOptions(sample_rate=10))
    assert loaded.channels == ("x", "y", "z")
    assert_allclose(loaded.time, np.arange(5) / 10)


def test_pickled_objects_are_refused(tmp_path):
    path = tmp_path / "d.npz"
    np.savez(path, time=np.arange(9.0), values=np.array([object()] * 9))
    with pytest.raises(SkillFileError, match=r"not a readable \.npz"):
        Demonstration.load(path)


@pytest.mark.parametrize("kind", [str, complex])
def test_arrays_without_real_numbers_are_refused(tmp_path, kind):
    path = tmp_path / "d.npz"
    np.savez(path, time=np.arange(9.0), values=np.full((9, 2), 1).astype(kind))
    with pytest.raises(SkillFileError, match="`values` does not hold numbers"):
        Demonstration.load(path)


def with_metadata(path, metadata):
    np.savez(
        path,
        metadata=np.array(json.dumps(metadata)),
        time=np.arange(9.0),
        values=np.zeros((9, 1)),
    )
    return path


def test_newer_version_is_refused(tmp_path):
    newer = {"format": FORMAT.name, "version": FORMAT.version + 1}
    path = with_metadata(tmp_path / "d.npz", newer)
    with pytest.raises(SkillFileError, match=r"version 2; .* Update fmp_drake"):
        Demonstration.load(path)


@pytest.mark.parametrize(
    "metadata",
    [
        [1],
        "text",
        {"format": "fmp-drake-skill", "version": 1},
        {"version": 1},
        {"format": FORMAT.name, "version": "two"},
    ],
)
def test_foreign_metadata_is_refused(tmp_path, metadata):
    path = with_metadata(tmp_path / "d.npz", metadata)
    with pytest.raises(SkillFileError, match="not a demonstration of fmp_drake"):
        Demonstration.load(path)


def test_metadata_without_names_of_channels_name_the_file(tmp_path):
    metadata = {"format": FORMAT.name, "version": 1, "channels": 3}
    path = with_metadata(tmp_path / "d.npz", metadata)
    with pytest.raises(DemonstrationError, match=r"d\.npz: channels is 3; expected"):
        Demonstration.load(path)


def test_numbers_that_cannot_be_used_name_the_file(tmp_path):
    path = tmp_path / "d.npz"
    np.savez(path, time=np.zeros(9), position=np.zeros((9, 3)))
    with pytest.raises(
        DemonstrationError, match=r"d\.npz: the time stays the same in 8 of 9"
    ):
        Demonstration.load(path)


def csv_file(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "d.csv"
    path.write_bytes(text.encode(encoding))
    return path


FIVE = "".join(f"{i / 10},{i},{-i}\n" for i in range(5))


@pytest.mark.parametrize(
    ("header", "channels", "units"),
    [
        ("time,x,y\n", ("x", "y"), ("m", "m")),
        ("time [s], x [m], force [N]\n", ("x", "force"), ("m", "N")),
        ("\n  time ,x,y\n", ("x", "y"), ("m", "m")),
    ],
)
def test_csv_header_names_channels_and_units(tmp_path, header, channels, units):
    loaded = Demonstration.load(csv_file(tmp_path, header + FIVE))
    assert loaded.channels == channels
    assert loaded.units == units
    assert np.array_equal(loaded.values[:, 1], -np.arange(5.0))


def test_channels_without_a_unit_keep_their_names_in_a_csv(tmp_path):
    recording = Demonstration(
        time=np.arange(20) / 20,
        values=np.zeros((20, 2)),
        channels=("x", "q[1]"),
        units=("m", "1"),
    )
    recording.save(tmp_path / "a.csv")
    read = Demonstration.load(tmp_path / "a.csv")
    assert (read.channels, read.units) == (recording.channels, recording.units)


def test_csv_time_may_be_any_column(tmp_path):
    text = "x,time\n" + "".join(f"{i},{i / 10}\n" for i in range(5))
    loaded = Demonstration.load(csv_file(tmp_path, text))
    assert loaded.channels == ("x",)
    assert_allclose(loaded.time, np.arange(5) / 10)


def test_csv_of_a_spreadsheet_may_start_with_a_byte_order_mark(tmp_path):
    path = csv_file(tmp_path, "time,x,y\r\n" + FIVE.replace("\n", "\r\n"), "utf-8-sig")
    assert Demonstration.load(path).channels == ("x", "y")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("\n\n", "is empty"),
        ("a,x,y\n" + FIVE, "no column holds the time; the columns are a, x, y"),
        ("time\n0\n1\n2\n3\n", "a time column but no channel"),
        ("time,x,y\n0,1,2\n0.1,1\n", r"1 of 2 rows broken \(line 3: 2 cells"),
        (
            "time,x,y\n0,1,2\n\n0.1,one,2\n",
            r"1 of 2 rows broken \(line 4: 'one' in x\); delete them: sed ",
        ),
        ("time,x\n" + FIVE, "line 2 has 3 cells; the header has 2"),
    ],
)
def test_broken_csv_is_refused(tmp_path, text, message):
    with pytest.raises(SkillFileError, match=message):
        Demonstration.load(csv_file(tmp_path, text))


def test_csv_in_another_encoding_is_read(tmp_path):
    for encoding in ("latin-1", "utf-16"):
        path = csv_file(tmp_path, "time,x,größe\n" + FIVE, encoding=encoding)
        assert Demonstration.load(path).channels == ("x", "größe")


def test_csv_numbers_that_cannot_be_used_name_the_file(tmp_path):
    path = csv_file(tmp_path, "time,x,y\n" + FIVE.replace("0.3,3", "0.3,inf"))
    with pytest.raises(DemonstrationError, match=r"d\.csv: values holds 1 NaN"):
        Demonstration.load(path)
    path = csv_file(tmp_path, "time,x,y\n0,1,2\n")
    with pytest.raises(DemonstrationError, match="1 samples"):
        Demonstration.load(path)


def test_real_demonstrations_load_and_resample(real_demonstration_paths):
    for path in real_demonstration_paths.values():
        demonstration = Demonstration.load(path)
        assert demonstration.channels == ("x", "y", "z")
        resampled = demonstration.resample(20)
        assert resampled.is_uniform(20)
        assert resampled.duration == pytest.approx(demonstration.duration, abs=0.051)
        # No channel leaves the recorded range by more than the filter's ringing.
        span = np.ptp(demonstration.values, axis=0)
        low, high = demonstration.values.min(axis=0), demonstration.values.max(axis=0)
        assert np.all(resampled.values > low - 0.05 * span - 1e-3), path
        assert np.all(resampled.values < high + 0.05 * span + 1e-3), path
