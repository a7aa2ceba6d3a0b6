"""Facts about the uncertainty of what a mixture plays."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter1d
from scipy.stats import chi2

from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    load_skill,
    save_skill,
    transform_space,
)
from fmp_drake.primitives.model.movement_primitive import copy_skill


@pytest.fixture(scope="module", params=[0, 4])
def aimless(request):
    """A mixture of 20 s in which nothing repeats, and what follows."""
    noise = np.random.default_rng(request.param).standard_normal((700, 2))
    y = gaussian_filter1d(noise, 10, axis=0)
    skill = FourierMovementPrimitive(rate=20.0).fit(y[:400])
    assert skill.model_ == "mixture"
    return skill, y[400:]


def inside(skill, y, ahead):
    """Return which fraction of a movement is in the 95 % tube of what is played."""
    k, found = skill.overlap, []
    for i in range(0, len(y) - k - ahead, 5):
        mapping = skill.map_partial(y[i : i + k])
        component = skill.components_[mapping.component]
        played = skill.synthesize(component.confined(mapping.weights, 0.99))
        step = k - 1 + ahead
        error = y[i + step] - played[step]
        covariance = skill.predicted_covariance(mapping.component, step)
        found.append(error @ np.linalg.solve(covariance, error) < chi2.ppf(0.95, 2))
    return np.mean(found)


def test_tube_of_a_played_mixture_holds_what_follows(aimless):
    skill, y = aimless
    for ahead in (5, 10, 20):
        assert inside(skill, y, ahead) > 0.85
    # The errors of replay are smaller than those of the mixture.
    calibration = replace(skill.calibration_, playback_covariances=None)
    by_replay = copy_skill(skill, calibration_=calibration)
    assert inside(by_replay, y, 20) < 0.75


def test_errors_of_a_played_mixture_are_saved_and_rotated(aimless, tmp_path):
    skill, _ = aimless
    save_skill(skill, tmp_path / "skill.npz")
    loaded = load_skill(tmp_path / "skill.npz")
    one, two = (s.predicted_covariance(0, 40) for s in (skill, loaded))
    assert np.array_equal(one, two)
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    turned = transform_space(skill, rotation=quarter, channels=["x", "y"])
    expected = quarter @ one @ quarter.T
    assert_allclose(turned.predicted_covariance(0, 40), expected)


def test_predictions_are_calibrated_by_their_own_errors(aimless):
    skill, y = aimless
    calibration = replace(skill.calibration_, playback_covariances=None)
    other = copy_skill(skill, calibration_=calibration)
    one, two = (s.predict(y[:10], 20).covariances for s in (skill, other))
    assert np.array_equal(one, two)


@pytest.mark.parametrize("model", ["automatic", "mixture"])
@pytest.mark.parametrize("seconds", [8, 20])
def test_channels_inferred_by_a_mixture_of_few_windows_are_in_the_tube(model, seconds):
    noise = np.random.default_rng(2).standard_normal((900, 3))
    y = gaussian_filter1d(noise, 10, axis=0)
    y[:, 2] = 2 * y[:, 0] + 0.3 * y[:, 2]
    known, held = y[: 20 * seconds], y[400:]
    skill = FourierMovementPrimitive(rate=20.0, model=model).fit(known)
    assert skill.model_ == "mixture"
    for observed, inferred in (([0], [1, 2]), ([2], [0, 1]), ([0, 1], [2])):
        prediction = skill.infer(held[:, observed], observed)
        error = held[:, inferred] - prediction.values
        solved = np.linalg.solve(prediction.covariances, error[..., None])[..., 0]
        is_inside = np.sum(error * solved, axis=1) < chi2.ppf(0.95, len(inferred))
        assert np.mean(is_inside) > 0.85, observed


def test_noise_of_a_recording_is_not_amplified_at_the_end_of_its_windows():
    rng, t = np.random.default_rng(0), np.arange(0, 60, 0.05)
    path = gaussian_filter1d(rng.standard_normal((len(t), 2)), 12, axis=0)
    path *= 0.1 / path.std(axis=0)
    values = np.column_stack([path, 0 * t]) + 1e-3 * rng.standard_normal((len(t), 3))
    skill = FourierMovementPrimitive().fit(Demonstration(time=t, values=values))
    paper = skill.n_steps - skill.overlap
    players = [Player(skill, sample=True, seed=3, remap_ticks=n) for n in (None, paper)]
    assert [p.ticks_between_remaps for p in players] == [paper - 3, paper]
    heights = [
        np.abs(p.rollout(skill.extent_.mean(axis=0), 60.0).position[200:, 2]).max()
        for p in players
    ]
    assert heights[0] < 0.01
    assert heights[1] > 0.03
