"""Facts about replaying demonstrations."""

import numpy as np

from fmp_drake.experiments.baselines import ProMP, Replay
from fmp_drake.primitives import sliding_windows


def test_samples_are_windows_and_the_past_is_remembered():
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.standard_normal((300, 2)), axis=0)
    windows = sliding_windows(path, n_steps=60, stride=5)
    model = Replay(neighbours=1).fit(windows)
    for sample in model.sample(5, seed=3):
        assert np.any(np.all(windows == sample, axis=(1, 2)))
    np.testing.assert_allclose(model.predict(path[100:110], 20), path[110:130])


def test_memories_begin_at_the_present_value_and_the_move_decays():
    path = np.sin(np.arange(300) * np.pi / 10)[:, None]
    model = Replay(anchor_time=10.0).fit(sliding_windows(path, n_steps=60, stride=5))
    moved = model.predict(path[:10] + 0.1, 20) - path[10:30]
    np.testing.assert_allclose(moved[:, 0], 0.1 * np.exp(-np.arange(1, 21) / 10))


def test_a_promp_finds_the_frequencies_of_the_movement():
    t = np.arange(500)
    path = np.sin(2 * np.pi * t / 37) + 0.3 * np.cos(4 * np.pi * t / 37)
    windows = sliding_windows(path[:, None], n_steps=60, stride=5)
    model = ProMP(frequencies=2).fit(windows)
    np.testing.assert_allclose(model.frequencies_, [60 / 37, 120 / 37], rtol=0.01)
    error = model.predict(path[:10, None], 20)[:, 0] - path[10:30]
    assert np.abs(error).max() < 0.02
