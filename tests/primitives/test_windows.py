"""Facts about sliding windows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration, sliding_windows
from fmp_drake.primitives.data.windows import (
    as_windows,
    cut_demonstrations,
    weighted_windows,
)


def counting(count, rate=20.0, start=0.0, **names):
    """Return a demonstration whose channels tell the number of the sample."""
    i = np.arange(count, dtype=float)
    values = np.column_stack([start + i, -i])
    return Demonstration(time=i / rate, values=values, **names)


@given(count=st.integers(1, 60), n_steps=st.integers(1, 30), stride=st.integers(1, 15))
def test_windows_are_slices_a_stride_apart(count, n_steps, stride):
    values = np.arange(2.0 * count).reshape(count, 2)
    windows = sliding_windows(values, n_steps=n_steps, stride=stride)
    starts = range(0, count - n_steps + 1, stride)
    assert windows.shape == (len(starts), n_steps, 2)
    for window, start in zip(windows, starts, strict=True):
        assert np.array_equal(window, values[start : start + n_steps])


def test_windows_of_two_arms_at_100_hz_are_not_refused():
    recording = np.zeros((700, 14))
    assert as_windows([recording], n_steps=600, stride=10, rate=100.0).values.size


def test_three_minutes_at_20_hz_give_349_windows_as_in_the_paper():
    windows = sliding_windows(np.zeros((3600, 3)), n_steps=120, stride=10)
    assert windows.shape == (349, 120, 3)


@pytest.mark.parametrize(
    "options", [{"n_steps": 0, "stride": 1}, {"n_steps": 1, "stride": 0}]
)
def test_windows_and_strides_of_no_length_are_refused(options):
    with pytest.raises(DemonstrationError, match="at least 1"):
        sliding_windows(np.zeros((9, 1)), **options)


def test_each_demonstration_is_windowed_on_its_own():
    demonstrations = [counting(50), counting(31, start=1000), counting(20)]
    windows = as_windows(demonstrations, n_steps=24, stride=5, rate=20.0).values
    assert windows.shape == (6 + 2 + 0, 24, 2)
    assert np.all(np.diff(windows[..., 0], axis=1) == 1)
    assert np.sum(windows[:, 0, 0] >= 1000) == 2


def test_no_window_crosses_a_gap():
    whole = counting(100)
    time = whole.time + np.where(whole.time > 2.0, 30.0, 0.0)
    gap = Demonstration(time=time, values=whole.values)
    windows = as_windows([gap, whole], n_steps=24, stride=4, rate=20.0)
    assert np.all(np.diff(windows.values[..., 0], axis=1) == 1)
    assert np.sum(windows.sources[windows.part] == 0) == 5 + 9
    assert [len(path) for path in windows.paths(4)] == [40, 56, 100]
    assert [len(y) for y in windows.recordings()] == [41, 59, 100]
    used, weights = weighted_windows(windows, [0.0, 1.0])
    assert [len(y) for y in used.recordings()] == [100]
    assert np.all(weights == 1)


def test_demonstrations_are_resampled_to_the_rate():
    slow, fast = counting(41, rate=10.0), counting(161, rate=40.0)
    windows = as_windows([slow, fast], n_steps=20, stride=20, rate=20.0).values
    assert windows.shape == (4 + 4, 20, 2)
    assert np.allclose(np.diff(windows[:4, :, 0], axis=1), 0.5)


def test_windows_of_a_closed_path_are_joined_where_all_samples_agree():
    path = np.array([0.0, 5, 1, 5, 2, 3, 4, 6, 7, 8, 9, 5])[:, None]
    windows = sliding_windows(path, n_steps=6, stride=3)
    (joined,) = as_windows(windows, n_steps=6, stride=3, rate=20.0).recordings()
    assert np.array_equal(joined, path)


def test_no_demonstration_is_refused():
    with pytest.raises(DemonstrationError, match="at least one"):
        as_windows([], n_steps=8, stride=1, rate=20.0)


def test_part_of_windows_is_refused():
    windows = np.zeros((3, 8, 2))
    with pytest.raises(
        DemonstrationError, match="windows have no start_time and end_time"
    ):
        cut_demonstrations(windows, 1.0, None, 20.0)
    assert cut_demonstrations(windows, None, None, 20.0) is windows


def test_different_channels_are_refused():
    other = counting(50, channels=("x", "z"))
    with pytest.raises(
        DemonstrationError, match="demonstration 2 has the channels x, z"
    ):
        as_windows([counting(50), other], n_steps=8, stride=1, rate=20.0)


def test_error_of_a_short_demonstration_states_the_least_duration():
    with pytest.raises(DemonstrationError) as caught:
        as_windows([counting(25)], n_steps=24, stride=10, rate=20.0)
    assert "give 1 window of 1.2 s" in str(caught.value)
    assert "the longest lasts 1.2 s" in str(caught.value)
    assert "at least 1.65 s" in str(caught.value)
    with pytest.raises(DemonstrationError, match=r"the longest lasts 1 s"):
        as_windows(
            [counting(9), counting(21), counting(11)], n_steps=24, stride=1, rate=20.0
        )
    # And with that length it is accepted.
    enough = counting(int(1.65 * 20) + 1)
    assert len(as_windows([enough], n_steps=24, stride=10, rate=20.0).values) == 2
