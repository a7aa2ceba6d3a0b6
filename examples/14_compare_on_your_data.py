"""
Which model suits my data?
==========================

Score movement primitives by their prediction error of the next second on held-out data.
"""

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.experiments.baselines import ProMP
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import models_dir

recording = Demonstration.load(models_dir() / "demonstrations" / "polishing.npz")
uniform = recording.resample(20.0)
cut = 2 * len(uniform.values) // 3
seen, unseen = uniform.values[:cut], uniform.values[cut:]
print(f"learned from {cut / 20:.0f} s, scored on {len(unseen) / 20:.0f} s")

# %%
# Fourier movement primitives
# ---------------------------
# The mixture and the phase model, which knows that the movement is a cycle.

half = Demonstration(
    time=uniform.time[:cut],
    values=seen,
    channels=uniform.channels,
    units=uniform.units,
)
models = {
    name: FourierMovementPrimitive(model=name).fit(half)
    for name in ("mixture", "phase")
}

# %%
# The simplest rival
# ------------------
# "Go on as you did when it looked like this": the best match of the last half second in the
# recording, started where the movement is. Whoever cannot beat it has learned nothing.

K, HORIZON = 10, 20


def replayed(past: np.ndarray) -> np.ndarray:
    """Return what followed the best match of the last K samples, (HORIZON, D)."""
    last = np.arange(len(seen) - K - HORIZON)
    matches = [np.sum((seen[i : i + K] - past) ** 2) for i in last]
    best = int(np.argmin(matches))
    return seen[best + K : best + K + HORIZON] - seen[best + K - 1] + past[-1]


errors: dict[str, list[float]] = {name: [] for name in (*models, "replay")}
for first in range(0, len(unseen) - K - HORIZON, 10):
    past = unseen[first : first + K]
    truth = unseen[first + K : first + K + HORIZON]
    ways = {name: m.predict(past, HORIZON).values for name, m in models.items()}
    ways["replay"] = replayed(past)
    for name, way in ways.items():
        errors[name].append(float(np.sqrt(np.mean(np.sum((way - truth) ** 2, axis=1)))))

figure, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
ax.boxplot(
    [1e3 * np.array(e) for e in errors.values()],
    orientation="horizontal",
    tick_labels=list(errors),
    showfliers=False,
)
ax.set(xlabel="error over the next second (mm); less is better")
plt.show()
for name, values in errors.items():
    print(f"{name:8} {1e3 * np.sqrt(np.mean(np.square(values))):5.1f} mm")

# %%
# `ProMP` is an estimator with the same methods, `AlignedProMP`, `PeriodicDMP` and `PeriodicGP`
# are methods of the benchmark. `fmp-drake benchmark` scores all of them, and more, on the
# recordings in a folder.

promp = ProMP(frequencies=5, n_components=20)
print(promp)
