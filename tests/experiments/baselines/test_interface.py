"""Facts about every model behind the common interface."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import FmpError, SkillError
from fmp_drake.experiments.baselines import (
    AlignedProMP,
    FourierModel,
    PeriodicDMP,
    PeriodicGP,
    ProMP,
    TrajectoryModel,
    best_on_held_out,
)

MODELS = {
    "fourier": FourierModel(),
    "promp": ProMP(frequencies=(2,)),
    "promp mixture": ProMP(frequencies=(2,), n_components=10),
    "promp mult": ProMP(frequencies=(1, 2, 3, 4, 5), n_components=4),
    "aligned promp": AlignedProMP(),
    "dmp": PeriodicDMP(),
    "gp": PeriodicGP(n_points=60, n_moments=8),
}


@pytest.fixture(scope="module", params=list(MODELS))
def model(request, eight_windows):
    return MODELS[request.param].fit(eight_windows)


def test_shapes(model, eight_windows):
    assert isinstance(model, TrajectoryModel)
    t = model.n_steps_
    assert model.sample(3, seed=1).shape == (3, t, 2)
    assert model.sample(0).shape == (0, t, 2)
    density = model.log_density(eight_windows)
    assert density is None or density.shape == (len(eight_windows),)
    given = model.condition([0, 7.5], eight_windows[0][[0, 7]])
    assert given.mean.shape == (t, 2)
    assert given.covariance is None or given.covariance.shape == (t, 2, 2)
    assert given.responsibilities[given.component] == given.responsibilities.max()
    assert given.responsibilities.sum() == pytest.approx(1)
    assert model.predict(eight_windows[0, :10], 33).shape == (33, 2)


def test_a_start_is_met(model):
    start = model.sample(1, seed=5)[0, 0]
    assert_allclose(model.condition([0], [start]).mean[0], start, atol=2e-3)


def test_samples_repeat_with_the_seed(model):
    assert np.array_equal(model.sample(4, seed=3), model.sample(4, seed=3))
    assert not np.array_equal(model.sample(4, seed=3), model.sample(4, seed=4))


def test_inputs_stay_as_they_are(model, eight_windows):
    before = eight_windows.copy()
    prefix = eight_windows[0, :10].copy()
    model.predict(prefix, 5)
    model.condition([0], prefix[:1])
    model.log_density(eight_windows)
    assert np.array_equal(before, eight_windows)
    assert np.array_equal(prefix, before[0, :10])


def test_bad_requests_are_errors_of_the_package(model):
    for call in (
        lambda: model.fit("text"),
        lambda: model.sample(-1),
        lambda: model.sample(1, seed=-1),
        lambda: model.condition([], np.zeros((0, 2))),
        lambda: model.condition([-1], [[0, 0]]),
        lambda: model.condition([0], [[0, np.nan]]),
        lambda: model.predict(np.zeros((0, 2)), 3),
        lambda: model.predict(np.zeros((3, 2)), 0),
    ):
        with pytest.raises(FmpError):
            call()


def test_fmp_predicts_past_its_window(eight_windows):
    model = FourierModel().fit(eight_windows)
    long = model.predict(eight_windows[0, :10], 200)
    assert_allclose(long[:60], model.predict(eight_windows[0, :10], 60))
    assert np.abs(long).max() < 2 * np.abs(eight_windows).max()
    assert_allclose(long[:15], eight_windows[0, 10:25], atol=0.03)


def test_the_best_on_held_out_windows_is_chosen(eight_windows):
    learned, held_out = eight_windows[:90], eight_windows[110:]
    candidates = [
        ProMP(frequencies=(2,), ridge=0.0),
        PeriodicDMP(),
        ProMP(frequencies=(3,)),
        ProMP(frequencies=(1, 2, 3, 4, 5)),
    ]
    told = []
    best, scores = best_on_held_out(candidates, learned, held_out, progress=told.append)
    assert best is candidates[3]
    assert np.array_equal(np.isfinite(scores), [False, False, True, True])
    assert len(told) == 4 - 1
    assert scores[3] == pytest.approx(best.log_density(held_out).mean())

    def error(model, windows):
        predicted = [model.predict(w[:10], 20) for w in windows[::5]]
        return -float(np.mean((np.array(predicted) - windows[::5, 10:30]) ** 2))

    best, scores = best_on_held_out(candidates, learned, held_out, score=error)
    assert np.isfinite(scores[1])
    with pytest.raises(SkillError, match="none of the 1 candidates"):
        best_on_held_out([PeriodicDMP()], learned, held_out)
