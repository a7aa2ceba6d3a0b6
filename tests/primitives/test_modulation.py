"""Facts about other magnitudes and phases of chosen harmonics."""

import numpy as np
import pytest
from dense_paper import dense
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from sklearn.exceptions import NotFittedError
from synthetic_recordings import waves

from fmp_drake.errors import SkillError
from fmp_drake.primitives import FourierMovementPrimitive, Player
from fmp_drake.primitives.editing.spectrum import (
    modulate_skill,
    modulate_windows,
    skill_spectrum,
)

T = 60


@pytest.mark.parametrize("t", [24, 25])
def test_gain_and_phase_change_the_cosines(t):
    before = waves([0, 1, 5], [1.0, 0.8, 0.6], [0.0, 0.4, -1.0], t)
    after = waves([0, 1, 5], [1.0, 1.6, 0.6], [0.0, 1.9, -1.0], t)
    out = modulate_windows(before[:, None], harmonics=[1], gain=2.0, phase=1.5)
    assert_allclose(out[:, 0], after, atol=1e-12)


@given(shift=st.integers(-30, 30), t=st.sampled_from([24, 25]))
def test_phase_that_grows_with_the_harmonic_is_a_shift_in_time(shift, t):
    y = np.random.default_rng(0).standard_normal((3, t, 2))
    if t % 2 == 0:  # Without the Nyquist harmonic.
        y = modulate_windows(y, harmonics=[t // 2], gain=0)
    out = y
    for k in range(1, (t + 1) // 2):
        angle = 2 * np.pi * k * shift / t
        out = modulate_windows(out, harmonics=[k], phase=angle)
    assert_allclose(out, np.roll(y, -shift, axis=1), atol=1e-12)


def test_only_the_chosen_channels_change():
    y = np.random.default_rng(0).standard_normal((3, T, 2))
    out = modulate_windows(y, harmonics=[2, 3], gain=0.5, phase=1.0, channels=[1])
    assert_allclose(out[..., 0], y[..., 0], atol=1e-12)
    assert np.max(np.abs(out[..., 1] - y[..., 1])) > 0.01


def test_mean_and_nyquist_harmonic_can_be_scaled():
    y = np.random.default_rng(0).standard_normal((3, 24, 1))
    out = modulate_windows(y, harmonics=[0, 12], gain=0.0)
    assert_allclose(out.mean(axis=1), 0, atol=1e-12)
    assert_allclose(np.fft.rfft(out, axis=1)[:, -1], 0, atol=1e-12)


def matrix(skill, **options):
    """Return the modulation as a matrix over the weights."""
    identity = skill.basis.synthesize(np.eye(skill.components_[0].dim))
    return skill.basis.analyze(modulate_windows(identity, **options)).T


@given(phase=st.floats(-4, 4), harmonic=st.integers(1, 11))
def test_shifted_phase_maps_the_distribution_exactly(small_skill, phase, harmonic):
    options = {"harmonics": [harmonic, 1], "phase": phase}
    out = modulate_skill(small_skill, **options)
    a = matrix(small_skill, **options)
    for one, two in zip(small_skill.components_, out.components_, strict=True):
        assert_allclose(two.mean, a @ one.mean, atol=1e-12)
        assert_allclose(dense(two), a @ dense(one) @ a.T, atol=1e-12)
        assert two.noise == one.noise
    windows = small_skill.sample(3, seed=4)
    assert_allclose(
        out.score_samples(modulate_windows(windows, **options)),
        small_skill.score_samples(windows),
        rtol=1e-7,
    )


@given(gain=st.floats(0, 3), phase=st.floats(-4, 4))
def test_gain_maps_all_but_the_white_noise(small_skill, gain, phase):
    options = {"harmonics": [1, 2], "gain": gain, "phase": phase}
    out = modulate_skill(small_skill, channels=["y"], **options)
    a = matrix(small_skill, channels=[1], **options)
    for one, two in zip(small_skill.components_, out.components_, strict=True):
        assert_allclose(two.mean, a @ one.mean, atol=1e-12)
        white = one.noise * np.eye(one.dim)
        assert_allclose(dense(two) - white, a @ (dense(one) - white) @ a.T, atol=1e-11)
        assert_allclose(two.basis.T @ two.basis, np.eye(two.rank), atol=1e-9)


def test_quieter_skill_is_played_with_smaller_strokes(wiping_skill):
    spectrum = skill_spectrum(wiping_skill)
    strongest = spectrum.peaks("y")[0].harmonic
    around = range(max(1, strongest - 2), strongest + 3)
    half = modulate_skill(wiping_skill, harmonics=around, gain=0.5, channels=["y"])
    start = wiping_skill.extent_.mean(axis=0)
    before = np.ptp(Player(wiping_skill).rollout(start, 40.0)[300:, 0], axis=0)
    after = np.ptp(Player(half).rollout(start, 40.0)[300:, 0], axis=0)
    assert after[1] < 0.8 * before[1]
    assert np.ptp(half.extent_[:, 1]) < np.ptp(wiping_skill.extent_[:, 1])


def test_skill_without_its_highest_harmonics_keeps_its_size(wiping_mixture):
    smooth = modulate_skill(wiping_mixture, harmonics=range(45, 61), gain=0.0)
    start = wiping_mixture.paths_[0][0]
    size, smooth_size = (
        np.ptp(Player(skill).rollout(start, 60.0).position[:, :2], axis=0)
        for skill in (wiping_mixture, smooth)
    )
    assert_allclose(smooth_size, size, rtol=0.25)


def test_skill_without_variation_can_be_modulated():
    skill = FourierMovementPrimitive(n_steps=8, overlap=2).fit(np.ones((4, 8, 1)))
    out = modulate_skill(skill, harmonics=[0], gain=3.0)
    assert_allclose(out.sample(2, with_noise=False), 3.0, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"harmonics": []}, "give some from 0 to 12"),
        ({"harmonics": [-1]}, "from 0 to 12"),
        ({"harmonics": [13]}, "from 0 to 12"),
        ({"harmonics": [1], "gain": -0.5}, "gain is -0.5; it must be at least 0"),
        ({"harmonics": [1], "gain": np.nan}, "gain is nan"),
        ({"harmonics": [1], "phase": np.inf}, "phase is inf"),
        ({"harmonics": [0, 1], "phase": 0.1}, "harmonic 0 is the mean"),
        ({"harmonics": [12], "phase": 0.1}, "harmonic 12 is .* Nyquist"),
    ],
)
def test_modulations_that_do_not_exist_are_refused(small_skill, options, message):
    with pytest.raises(SkillError, match=message):
        modulate_skill(small_skill, **options)
    with pytest.raises(SkillError, match=message):
        modulate_windows(np.zeros((24, 2)), **options)


def test_modulation_needs_windows_and_channels(small_skill):
    with pytest.raises(SkillError, match="no channel 'z'"):
        modulate_skill(small_skill, harmonics=[1], channels=["z"])
    with pytest.raises(SkillError, match="no channel 2"):
        modulate_windows(np.zeros((24, 2)), harmonics=[1], channels=[2])
    with pytest.raises(SkillError, match=r"shape \(24,\)"):
        modulate_windows(np.zeros(24), harmonics=[1])
    with pytest.raises(NotFittedError):
        modulate_skill(FourierMovementPrimitive(), harmonics=[1])
