"""Facts about the bases (21)."""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.promp import von_mises_bases


def test_rows_equal_equation_21():
    f, n, h, t = 3.0, 5, 0.7, 12
    rows = von_mises_bases(np.arange(t) / t, frequencies=(f,), n_bases=n, width=h)
    for step in range(t):
        z = step / t
        b = [np.exp(np.cos(2 * np.pi * f * (z - i / (n * f))) / h) for i in range(n)]
        assert_allclose(rows[step], np.array(b) / sum(b), rtol=1e-12)


@pytest.mark.parametrize("width", [0.01, 1.0, 100.0])
def test_the_bases_of_each_frequency_sum_to_one(width):
    z = np.linspace(-1, 2, 50)
    rows = von_mises_bases(z, frequencies=(1, 2, 5), n_bases=20, width=width)
    assert rows.shape == (50, 60)
    assert_allclose(rows.reshape(50, 3, 20).sum(axis=2), 1, rtol=1e-12)


def test_the_bases_are_periodic():
    z = np.linspace(0, 1, 17)
    bases = partial(von_mises_bases, frequencies=(2.5,), n_bases=7, width=0.5)
    assert_allclose(bases(z), bases(z + 1 / 2.5), atol=1e-12)
    # The next basis is the same one a seventh of a period later.
    later = bases(z + 1 / 2.5 / 7)
    assert_allclose(later[:, 1:], bases(z)[:, :-1], atol=1e-12)


def test_wide_bases_are_cosines():
    z = np.linspace(0, 1, 40, endpoint=False)
    rows = von_mises_bases(z, frequencies=(1,), n_bases=20, width=1000.0)
    cosine = (1 + np.cos(2 * np.pi * (z[:, None] - np.arange(20) / 20)) / 1000) / 20
    assert_allclose(rows, cosine, atol=1e-6 / 20)
    singular = np.linalg.svd(rows, compute_uv=False)
    assert np.all(singular[3:] < 1e-3 * singular[2])


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"frequencies": ()}, "frequencies"),
        ({"frequencies": (0.0,)}, "frequency is 0"),
        ({"frequencies": (np.nan,)}, "frequency is nan"),
        ({"frequencies": (1,), "n_bases": 2}, "n_bases is 2"),
        ({"frequencies": (1,), "width": 0.0}, "width is 0"),
    ],
)
def test_bad_parameters_are_named(options, match):
    with pytest.raises(ExperimentError, match=match):
        von_mises_bases([0.0], **options)
