"""Facts about ProMP over one aligned period."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import DemonstrationError
from fmp_drake.experiments.baselines import AlignedProMP


@pytest.fixture(scope="module")
def polished(split_windows):
    learned, _ = split_windows("polishing")
    return AlignedProMP().fit(learned)


def test_it_knows_one_period(polished):
    assert polished.n_steps_ == 40
    assert polished.period_ == pytest.approx(40, rel=0.02)
    assert polished.sample(7, seed=1).shape == (7, 40, 3)
    assert polished.log_density(np.zeros((1, 120, 3))) is None


def test_its_samples_are_as_the_aligned_periods(polished):
    samples, periods = polished.sample(4000, seed=1), polished.aligned_.values
    assert_allclose(samples.mean(axis=0), periods.mean(axis=0), atol=2e-3)
    assert_allclose(samples.std(axis=0), periods.std(axis=0), atol=3e-3)
    assert np.all(np.isfinite(polished.model_.log_density(periods)))


def test_far_from_the_demonstrated_start_it_is_overconfident(polished):
    """Fig. 6a: it has to leave its distribution to start in another region."""
    start = polished.aligned_.values.mean(axis=0)[20]  # Half a period off.
    given = polished.condition([0], [start])
    assert_allclose(given.mean[0], start, atol=1e-3)
    near = polished.condition([0], polished.aligned_.values[:1, 0])
    # It trusts in either alike.
    assert_allclose(given.covariance, near.covariance, rtol=1e-6)


def test_it_finds_the_phase_of_a_prefix(split_windows):
    learned, held_out = split_windows("eight")
    model = AlignedProMP().fit(learned)
    error, spread = [], []
    for window in held_out[::8]:
        error.append(model.predict(window[:10], 20) - window[10:30])
        spread.append(window[10:30] - learned.mean(axis=(0, 1)))
    # One second ahead, of 3 s: about 17 mm rms against 100 mm.
    assert np.mean(np.square(error)) < 0.1 * np.mean(np.square(spread))


def test_the_number_of_steps_can_be_chosen(eight_windows):
    model = AlignedProMP(n_steps=25).fit(eight_windows)
    assert model.sample().shape == (1, 25, 2)
    # Predictions are in samples all the same.
    window = eight_windows[3]
    assert_allclose(model.predict(window[:10], 15), window[10:25], atol=0.02)


def test_one_period_is_not_enough(eight):
    with pytest.raises(DemonstrationError, match=r"only one full period of 39\.7"):
        AlignedProMP().fit(eight[None, :85])


def test_nothing_works_before_fit():
    with pytest.raises(NotFittedError):
        AlignedProMP().predict(np.zeros((2, 2)), 3)
