"""The bundled demonstrations, and a small pattern that every model can learn."""

from pathlib import Path

import numpy as np
import pytest

from fmp_drake.primitives import Demonstration, sliding_windows

DEMONSTRATIONS = Path(__file__).resolve().parents[3] / "models" / "demonstrations"


@pytest.fixture(scope="session")
def bundled():
    """The function that reads a bundled demonstration, (n, 3) at 20 Hz."""

    def values(name):
        return Demonstration.load(DEMONSTRATIONS / f"{name}.npz").resample(20).values

    return values


@pytest.fixture(scope="session")
def split_windows(bundled):
    """The function that cuts one into learned and held-out windows, T = 120."""

    def split(name):
        y = bundled(name)
        cut = 3 * len(y) // 4
        parts = y[:cut], y[cut:]
        return [sliding_windows(part, n_steps=120, stride=10) for part in parts]

    return split


@pytest.fixture(scope="session")
def eight():
    """800 samples of an 8 with a wandering tempo, period 40: shape (800, 2)."""
    rng = np.random.default_rng(3)
    wander = np.cumsum(rng.standard_normal(800)) * 0.004
    phase = 2 * np.pi * np.arange(800) / 40 + wander - np.linspace(0, wander[-1], 800)
    clean = np.column_stack([0.05 * np.sin(2 * phase), 0.1 * np.sin(phase)])
    return clean + 3e-4 * rng.standard_normal(clean.shape)


@pytest.fixture(scope="session")
def eight_windows(eight):
    """Windows of it with T = 80."""
    return sliding_windows(eight, n_steps=80, stride=5)
