"""Facts about finding periods and aligning them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter1d

from fmp_drake.errors import DemonstrationError, ExperimentError
from fmp_drake.experiments.baselines.alignment import align_periods
from fmp_drake.primitives import sliding_windows
from fmp_drake.primitives.data.windows import joined_recordings
from fmp_drake.primitives.model.phase.period import autocorrelation, fundamental_period


@pytest.mark.parametrize("stride", [1, 7, 10])
def test_joined_windows_equal_their_recording(stride):
    y = np.random.default_rng(0).standard_normal((95, 2))
    windows = sliding_windows(y, n_steps=30, stride=stride)
    (joined,) = joined_recordings(windows)
    assert np.array_equal(joined, y[: len(joined)])
    assert len(y) - len(joined) < stride


def test_recordings_stay_apart():
    rng = np.random.default_rng(0)
    first, second = rng.standard_normal((2, 60, 2))
    parts = [sliding_windows(y, n_steps=30, stride=10) for y in (first, second)]
    joined = joined_recordings(np.concatenate(parts))
    assert [np.array_equal(a, b) for a, b in zip(joined, (first, second), strict=True)]
    apart = joined_recordings(sliding_windows(first, n_steps=30, stride=30))
    assert [len(y) for y in apart] == [30, 30]


def test_the_autocorrelation_is_literal():
    rng = np.random.default_rng(0)
    y = rng.standard_normal((50, 2))
    y -= y.mean(axis=0)
    slope = np.arange(50) - 24.5
    y -= slope[:, None] * (slope @ y) / (slope @ slope)
    r = autocorrelation([y], longest=20)
    for lag in (0, 3, 20):
        a, b = y[: 50 - lag], y[lag:]
        expected = np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2))
        assert r[lag] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "seconds"), [("polishing", 2.0), ("eight", 3.0), ("wiping", 4.8)]
)
@pytest.mark.parametrize("part", [slice(None), slice(0, 900), slice(1000, 1600)])
def test_the_period_of_a_bundled_demonstration_is_found(bundled, name, seconds, part):
    period = fundamental_period([bundled(name)[part]]) / 20
    assert period == pytest.approx(seconds, rel=0.02 if part == slice(None) else 0.05)


@pytest.mark.parametrize("period", [17.3, 40.0, 111.1])
@pytest.mark.parametrize("weights", [(0, 1), (1, 0.3), (1, 1)])
def test_the_period_of_a_noisy_pattern_is_found(period, weights):
    rng = np.random.default_rng(1)
    phase = 2 * np.pi * np.arange(1200) / period + rng.uniform(0, 6)
    tempo = 0.3 * gaussian_filter1d(rng.standard_normal(1200), 100) / 0.05
    y = np.column_stack(
        [
            np.sin(2 * (phase + tempo)),
            weights[0] * np.sin(phase + tempo)
            + weights[1] * np.cos(3 * (phase + tempo)),
        ]
    )
    if weights[0] == 0:  # 2 and 3 times the fundamental, which itself is absent.
        y[:, 1] *= 1.5
    y += 0.15 * rng.standard_normal(y.shape) + np.linspace(0, 1, 1200)[:, None]
    assert fundamental_period([y]) == pytest.approx(period, rel=0.02)


def test_the_period_is_found_in_several_recordings():
    t = np.arange(70)
    recordings = [np.sin(2 * np.pi * t / 25 + phase)[:, None] for phase in (0, 1, 4)]
    assert fundamental_period(recordings) == pytest.approx(25, rel=0.02)


def test_without_a_period_there_is_an_error():
    with pytest.raises(DemonstrationError, match="no period from 4 to 120 samples"):
        fundamental_period([np.linspace(0, 1, 200)[:, None] ** 3])
    with pytest.raises(DemonstrationError, match="longest recording has 6 samples"):
        fundamental_period([np.zeros((6, 1))])
    rng = np.random.default_rng(0)
    with pytest.raises(DemonstrationError, match="at least two full cycles"):
        fundamental_period([rng.standard_normal((2000, 2))])


@pytest.mark.parametrize(
    ("name", "remaining"), [("polishing", 0.03), ("eight", 0.03), ("wiping", 0.05)]
)
def test_aligned_periods_start_at_the_same_phase(bundled, name, remaining):
    y = bundled(name)
    period = fundamental_period([y])
    n = round(period)
    aligned = align_periods([y], period=period, n_steps=n)
    total = y.var(axis=0).sum()
    spread = aligned.values.var(axis=0).sum(axis=1).mean() / total
    cut = np.stack([y[i : i + n] for i in range(0, len(y) - n, n)])
    before = cut.var(axis=0).sum(axis=1).mean() / total
    assert before > 0.25
    assert spread < remaining
    assert aligned.durations.mean() == pytest.approx(period, rel=0.02)
    assert len(aligned.values) >= len(y) / period - 3


def test_aligned_periods_are_those_of_a_known_phase():
    rng = np.random.default_rng(1)
    tempo = 1 + gaussian_filter1d(rng.standard_normal(900), 60)  # 0.07 std
    phase = np.cumsum(2 * np.pi / 40 * tempo)
    y = np.column_stack([np.cos(phase), 0.4 * np.sin(2 * phase)])
    aligned = align_periods([y], period=40.0, n_steps=32)
    angle = 2 * np.pi * np.arange(32) / 32
    expected = np.column_stack([np.cos(angle), 0.4 * np.sin(2 * angle)])
    mean = aligned.values.mean(axis=0)
    # Phase 0 is the greatest of the template's samples: half a sample off at most.
    assert_allclose(mean, expected, atol=2 * np.pi / 32)
    assert aligned.values.std(axis=0).max() < 0.1


def test_recordings_that_are_too_short_to_align_are_refused():
    with pytest.raises(ExperimentError, match=r"longer than 1\.5 periods of 40"):
        align_periods([np.zeros((50, 2))], period=40.0, n_steps=40)
    y = np.sin(2 * np.pi * (np.arange(61) - 20) / 40)[:, None]  # Greatest at 30.
    with pytest.raises(ExperimentError, match="fewer than 2 full periods of 40"):
        align_periods([y], period=40.0, n_steps=20)
