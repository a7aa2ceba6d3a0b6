"""Facts about the periodic DMP."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines import PeriodicDMP


def learn(recording):
    dmp = PeriodicDMP()
    dmp.fit([recording])
    return dmp


@pytest.fixture(scope="module")
def model(eight):
    return learn(eight)


@pytest.fixture(scope="module")
def learned(bundled):
    """The three bundled demonstrations, learned."""
    names = ("polishing", "eight", "wiping")
    return {name: learn(bundled(name)[: 3 * len(bundled(name)) // 4]) for name in names}


@pytest.mark.parametrize(
    ("name", "seconds"), [("polishing", 2.0), ("eight", 3.0), ("wiping", 4.8)]
)
def test_the_frequency_is_the_demonstrated_one(learned, name, seconds):
    period = 2 * np.pi / learned[name].frequency_ / 20
    assert period == pytest.approx(seconds, rel=0.03)


@pytest.mark.parametrize("name", ["polishing", "eight", "wiping"])
def test_the_limit_cycle_is_the_demonstrated_one(learned, bundled, name):
    y = bundled(name)
    cycle = learned[name].cycle(np.linspace(0, 2 * np.pi, 200))
    distances = np.linalg.norm(y[:, None] - cycle, axis=2).min(axis=1)
    # A mean of varying cycles is a little smaller.
    assert np.sqrt(np.mean(distances**2)) < 0.2 * np.sqrt(y.var(axis=0).sum())


def test_it_converges_from_outside(model):
    n = round(3 * 2 * np.pi / model.frequency_)
    for start in ([0.5, 0.5], [-1.0, 0.0], [0.0, 0.0]):
        path = model.rollout(start, n, phase=1.0)
        assert_allclose(path[0], start)
        expected = model.cycle(1.0 + model.frequency_ * np.arange(n))
        error = np.linalg.norm(path - expected, axis=1)
        assert error[n // 3 :].max() < 1e-3  # After one period.
        assert error[-1] < 1e-5


def test_the_cycle_closes_and_is_its_own_rollout(model):
    assert_allclose(model.cycle(0.3), model.cycle(0.3 + 2 * np.pi), atol=1e-9)
    phases = model.frequency_ * np.arange(50)
    moving = (model.cycle(1e-4) - model.cycle(-1e-4)) / 2e-4 * model.frequency_
    path = model.rollout(model.cycle(0.0), 50, velocity=moving)
    assert_allclose(path, model.cycle(phases), atol=1e-4)


def test_it_predicts_the_next_second(learned, split_windows):
    windows, held_out = split_windows("polishing")
    error, spread = [], []
    for window in held_out[::6]:
        error.append(
            learned["polishing"].predict(window[:10], 20).values - window[10:30]
        )
        spread.append(window[10:30] - windows.mean(axis=(0, 1)))
    # About 16 mm rms against 81 mm.
    assert np.mean(np.square(error)) < 0.1 * np.mean(np.square(spread))


def test_a_prediction_starts_at_the_last_sample_and_returns_to_the_cycle(model):
    cycle = model.cycle(2.0 + model.frequency_ * np.arange(70))
    outside = cycle[:10] + np.array([0.0, 0.1])
    path = model.predict(outside, 60).values
    assert_allclose(path[0], outside[-1], atol=0.03)
    fine = model.cycle(np.linspace(0, 2 * np.pi, 4000))
    assert np.linalg.norm(path[45:, None] - fine, axis=2).min(axis=1).max() < 2e-3


def test_prediction_from_one_sample_continues_with_the_speed_of_the_cycle(model):
    cycle = model.cycle(0.7 + model.frequency_ * np.arange(21))
    assert_allclose(model.predict(cycle[:1], 20).values, cycle[1:], atol=5e-3)


def test_recordings_that_are_too_short_are_refused():
    with pytest.raises(ExperimentError, match="no recording is long enough"):
        learn(np.zeros((20, 2)))
