"""Facts about every model behind the common interface."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines import (
    AlignedProMP,
    PeriodicDMP,
    PeriodicGP,
    ProMP,
    TrajectoryModel,
)

MODELS = {
    "promp": ProMP(frequencies=(2,)),
    "promp mixture": ProMP(frequencies=(2,), n_components=10),
    "promp mult": ProMP(frequencies=(1, 2, 3, 4, 5), n_components=4),
    "aligned promp": AlignedProMP(),
    "dmp": PeriodicDMP(),
    "gp": PeriodicGP(),
}


@pytest.fixture(scope="module", params=list(MODELS))
def model(request, eight_windows):
    return MODELS[request.param].fit(eight_windows)


def test_shapes(model, eight_windows):
    assert isinstance(model, TrajectoryModel)
    prefix = eight_windows[0, :10]
    assert model.predict(prefix, 33).shape == (33, 2)
    tubes = model.tubes(prefix, 33)
    assert tubes is None or tubes.covariances.shape == (33, 2, 2)


def test_inputs_stay_as_they_are(model, eight_windows):
    before = eight_windows.copy()
    prefix = eight_windows[0, :10].copy()
    model.predict(prefix, 5)
    model.tubes(prefix, 5)
    assert np.array_equal(before, eight_windows)
    assert np.array_equal(prefix, before[0, :10])


def test_bad_requests_are_refused(model):
    for call in (
        lambda: model.fit("text"),
        lambda: model.predict(np.zeros((0, 2)), 3),
        lambda: model.predict([[0, np.nan]], 3),
        lambda: model.predict(np.zeros((3, 2)), 0),
    ):
        with pytest.raises(ExperimentError):
            call()


def test_nothing_works_before_fit(model):
    for name in ("predict", "tubes"):
        with pytest.raises(NotFittedError):
            getattr(clone(model), name)(np.zeros((2, 2)), 3)
