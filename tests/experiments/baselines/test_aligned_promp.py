"""Facts about ProMP over one aligned period."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines import AlignedProMP, ProMP


def learn(recording, **options):
    model = AlignedProMP(**options)
    model.fit([recording])
    return model


@pytest.fixture(scope="module")
def polished(bundled):
    recording = bundled("polishing")
    return learn(recording[: 3 * len(recording) // 4])


def test_model_covers_one_period(polished):
    assert polished.n_steps_ == 40
    assert polished.period_ == pytest.approx(40, rel=0.02)
    assert polished.model_.sample(7, seed=1).shape == (7, 40, 3)


def test_samples_resemble_the_aligned_periods(polished):
    samples, periods = polished.model_.sample(4000, seed=1), polished.aligned_.values
    assert_allclose(samples.mean(axis=0), periods.mean(axis=0), atol=2e-3)
    assert_allclose(samples.std(axis=0), periods.std(axis=0), atol=3e-3)


def test_period_starts_at_the_phase_of_the_start(polished):
    """Fig. 6a: a start in another region is outside the distribution."""
    start = polished.aligned_.values.mean(axis=0)[20]  # Half a period off.
    assert_allclose(polished.model_.condition([0], [start])[0], start, atol=1e-3)


def test_phase_of_a_prefix_is_found(bundled, split_windows):
    learned, held_out = split_windows("eight")
    recording = bundled("eight")
    model = learn(recording[: 3 * len(recording) // 4])
    error, spread = [], []
    for window in held_out[::8]:
        error.append(model.predict(window[:10], 20).values - window[10:30])
        spread.append(window[10:30] - learned.mean(axis=(0, 1)))
    # One second ahead, of 3 s: about 17 mm rms against 100 mm.
    assert np.mean(np.square(error)) < 0.1 * np.mean(np.square(spread))


def test_another_model_of_the_period_can_be_given(eight):
    wide = ProMP(frequencies=(1.0,), n_bases=9, width=1.0)
    model = learn(eight, model=wide)
    assert model.model_.means_.shape == (1, 2 * 9)
    assert not hasattr(wide, "means_")


def test_one_period_is_not_enough(eight):
    with pytest.raises(ExperimentError, match=r"fewer than 2 full periods of 39\.7"):
        learn(eight[:85])
