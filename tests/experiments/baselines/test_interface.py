"""Facts about every model behind the common interface."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines import (
    AlignedProMP,
    PeriodicDMP,
    PeriodicGP,
    ProMP,
    Replay,
    TrajectoryModel,
)
from fmp_drake.experiments.baselines.fourier_model import FourierModel

MODELS = {
    "fourier": FourierModel(),
    "phase": FourierModel(settings={"model": "phase"}),
    "promp": ProMP(frequencies=(2,)),
    "promp mixture": ProMP(frequencies=(2,), n_components=10),
    "promp mult": ProMP(frequencies=(1, 2, 3, 4, 5), n_components=4),
    "aligned promp": AlignedProMP(),
    "dmp": PeriodicDMP(),
    "replay": Replay(),
    "gp": PeriodicGP(),
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
    assert model.predict(eight_windows[0, :10], 33).shape == (33, 2)


def test_samples_repeat_with_the_seed(model):
    assert np.array_equal(model.sample(4, seed=3), model.sample(4, seed=3))
    assert not np.array_equal(model.sample(4, seed=3), model.sample(4, seed=4))


def test_inputs_stay_as_they_are(model, eight_windows):
    before = eight_windows.copy()
    prefix = eight_windows[0, :10].copy()
    model.predict(prefix, 5)
    model.log_density(eight_windows)
    assert np.array_equal(before, eight_windows)
    assert np.array_equal(prefix, before[0, :10])


def test_bad_requests_are_refused(model):
    for call in (
        lambda: model.fit("text"),
        lambda: model.sample(-1),
        lambda: model.sample(1, seed=-1),
        lambda: model.sample(1.5),
        lambda: model.predict(np.zeros((0, 2)), 3),
        lambda: model.predict([[0, np.nan]], 3),
        lambda: model.predict(np.zeros((3, 2)), 0),
    ):
        with pytest.raises(ExperimentError):
            call()


def test_fmp_predicts_past_its_window(eight_windows):
    model = FourierModel().fit(eight_windows)
    long = model.predict(eight_windows[0, :10], 200)
    assert_allclose(long[:60], model.predict(eight_windows[0, :10], 60))
    assert np.abs(long).max() < 2 * np.abs(eight_windows).max()
    assert_allclose(long[:15], eight_windows[0, 10:25], atol=0.03)


def test_nothing_works_before_fit(model):
    with pytest.raises(NotFittedError):
        clone(model).sample()
    with pytest.raises(NotFittedError):
        clone(model).predict(np.zeros((2, 2)), 3)
