"""Facts about the statistics of magnitude and phase, and their synthesis."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from synthetic_recordings import waves

from fmp_drake.errors import SkillError
from fmp_drake.primitives import FourierMovementPrimitive, sliding_windows
from fmp_drake.primitives.editing.spectrum import (
    Spectrum,
    skill_spectrum,
    window_spectrum,
)

RATE = 20.0
T = 60


def sliding(signal, duration=60.0, t=T, stride=3):
    """Return windows (N, T, D) of a function of time."""
    time = np.arange(int(duration * RATE)) / RATE
    return sliding_windows(np.stack(signal(time), axis=1), n_steps=t, stride=stride)


# Statistics -------------------------------------------------------------


def test_magnitude_and_phase_are_those_of_the_cosines():
    y = waves([0, 1, 4], [0.3, 2.0, 0.5], [0.0, 0.7, -2.5])
    spectrum = window_spectrum(y[None, :, None], rate=RATE)
    expected = np.zeros(31)
    expected[[0, 1, 4]] = 0.3, 2.0, 0.5
    assert_allclose(spectrum.magnitude_mean[:, 0], expected, atol=1e-12)
    assert_allclose(spectrum.phase_mean[[0, 1, 4], 0], [0, 0.7, -2.5], atol=1e-9)
    assert_allclose(spectrum.frequencies, np.arange(31) / 3)
    variance = np.array([2.0**2, 0.5**2]) / 2
    assert_allclose(spectrum.fractions[[1, 4], 0], variance / variance.sum())


@pytest.mark.parametrize("t", [24, 25])
def test_fractions_add_up_to_the_variance_within_windows(t):
    y = np.random.default_rng(0).standard_normal((9, t, 2))
    spectrum = window_spectrum(y, rate=RATE)
    assert_allclose(spectrum.fractions.sum(axis=0), 1)
    power = spectrum.magnitude_mean**2 + spectrum.magnitude_std**2
    factor = np.full(len(power), 0.5)
    factor[0] = 0
    if t % 2 == 0:
        factor[-1] = 1
    assert_allclose(factor @ power, y.var(axis=1).mean(axis=0))
    # As (1) has it.
    weights = np.abs(np.fft.fft(y, axis=1))[:, 3] * 2 / t
    assert_allclose(spectrum.magnitude_mean[3], weights.mean(axis=0))
    assert_allclose(spectrum.magnitude_std[3], weights.std(axis=0))


def test_phases_of_one_draw_have_their_mean_and_circular_deviation():
    rng = np.random.default_rng(1)
    # Around pi, where plain means fail.
    phases = np.pi + 0.2 * rng.standard_normal(4000)
    y = np.stack([waves([2], [1.0], [p]) for p in phases])[:, :, None]
    spectrum = window_spectrum(y, rate=RATE)
    assert np.cos(spectrum.phase_mean[2, 0] - np.pi) > 0.9999
    assert spectrum.phase_std[2, 0] == pytest.approx(0.2, abs=0.01)


def circle_and_eight(time):
    a = 2 * np.pi * time  # 1 Hz: 3 cycles in a window of 3 s
    return [np.cos(a + 0.4), 0.5 * np.cos(a + 0.4 - 1.1), 0.2 * np.cos(2 * a + 2.0)]


def test_phases_of_sliding_windows_are_uniform_and_relative_ones_are_not():
    spectrum = window_spectrum(sliding(circle_and_eight), rate=RATE)
    assert spectrum.phase_std[3, 0] > 2
    assert spectrum.relative_phase_std[3, 1] < 1e-3
    assert spectrum.relative_phase_mean[3, 1] == pytest.approx(-1.1)
    assert_allclose(spectrum.relative_phase_mean[:, 0], 0, atol=1e-9)


def test_spectrum_of_a_skill_is_near_that_of_its_windows(polishing_demonstration):
    skill = FourierMovementPrimitive(
        n_steps=40, rate=10.0, overlap=4, n_components=8, stride=1
    ).fit(polishing_demonstration)
    windows = sliding_windows(
        polishing_demonstration.resample(10).values, n_steps=40, stride=1
    )
    one = window_spectrum(windows, rate=10.0, channels=("x", "y"))
    two = skill_spectrum(skill)
    assert two.channels == ("x", "y")
    assert_allclose(two.fractions, one.fractions, atol=0.03)
    strongest = int(np.argmax(one.fractions[:, 0]))
    assert_allclose(
        two.magnitude_mean[strongest], one.magnitude_mean[strongest], rtol=0.1
    )
    gap = two.relative_phase_mean[strongest] - one.relative_phase_mean[strongest]
    assert np.all(np.cos(gap) > 0.98)
    again = skill_spectrum(skill)
    assert np.array_equal(again.magnitude_mean, two.magnitude_mean)


@pytest.mark.parametrize("cycles", [4.0, 4.3, 4.5, 7.77])
def test_frequency_of_a_sinusoid_is_found_between_harmonics(cycles):
    frequency = cycles * RATE / T
    windows = sliding(lambda t: [np.cos(2 * np.pi * frequency * t)], stride=1)
    (peak, *_) = window_spectrum(windows, rate=RATE).peaks(0)
    assert peak.frequency == pytest.approx(frequency, rel=5e-3)
    assert peak.fraction > 0.95
    assert peak.harmonic in (int(cycles), int(cycles) + 1)


def test_frequencies_of_a_superposition_are_found_with_their_fractions():
    def signal(t):
        return [0.3 * np.cos(2 * np.pi * t) + 0.1 * np.sin(2 * np.pi * 4 * t)]

    windows = sliding(signal)
    spectrum = window_spectrum(windows, rate=RATE)
    first, second = spectrum.peaks("c0")
    assert spectrum.peaks("c0", count=1) == (first,)
    assert spectrum.peaks("c0", least_fraction=0.2) == (first,)
    assert first.frequency == pytest.approx(1.0)
    assert first.fraction == pytest.approx(0.9)
    assert second.frequency == pytest.approx(4.0)
    assert second.fraction == pytest.approx(0.1)


def test_constant_channels_have_no_peak():
    spectrum = window_spectrum(np.full((3, T, 1), 0.2), rate=RATE)
    assert spectrum.peaks(0) == ()
    assert_allclose(spectrum.magnitude_mean[0], 0.2)
    assert np.all(spectrum.fractions == 0)


def test_spectrum_is_read_only():
    spectrum = window_spectrum(np.ones((3, T, 1)), rate=RATE)
    assert isinstance(spectrum, Spectrum)
    with pytest.raises(ValueError, match="read-only"):
        spectrum.fractions[0] = 1
    with pytest.raises(AttributeError):
        spectrum.channels = ("y",)


@pytest.mark.parametrize(
    ("windows", "options", "message"),
    [
        (np.zeros((T, 1)), {}, r"shape \(60, 1\)"),
        (np.zeros((0, T, 1)), {}, "windows, samples, channels"),
        (np.full((2, T, 1), np.nan), {}, "NaN or infinite"),
        (np.zeros((2, T, 1)), {"rate": 0.0}, "must be positive"),
        (np.zeros((2, T, 1)), {"channels": ("x", "y")}, "2 channel names for 1"),
    ],
)
def test_data_without_a_spectrum_are_refused(windows, options, message):
    with pytest.raises(SkillError, match=message):
        window_spectrum(windows, **{"rate": RATE, **options})


def test_eight_is_a_superposition_of_two_frequencies(make_demonstration):
    shown = make_demonstration("eight", seconds=60, seed=3).resample(20)
    windows = sliding_windows(shown.values, n_steps=120, stride=2)
    spectrum = window_spectrum(windows, rate=20.0, channels=shown.channels)
    peaks = {name: spectrum.peaks(name)[0] for name in ("x", "y")}
    slow, fast = sorted(peaks, key=lambda name: peaks[name].frequency)
    ratio = peaks[fast].frequency / peaks[slow].frequency
    assert ratio == pytest.approx(2, abs=0.25)
    assert min(peak.fraction for peak in peaks.values()) > 0.8
