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
training, test = uniform.values[:cut], uniform.values[cut:]
print(f"learned from {cut / 20:.0f} s, scored on {len(test) / 20:.0f} s")

# %%
# Fourier movement primitives
# ---------------------------
# The mixture, and the phase model, which assumes that the movement is a cycle.

demonstration = Demonstration(
    time=uniform.time[:cut],
    values=training,
    channels=uniform.channels,
    units=uniform.units,
)
models = {
    name: FourierMovementPrimitive(model=name).fit(demonstration)
    for name in ("mixture", "phase")
}

# %%
# The simplest baseline
# ---------------------
# Replay finds the best match of the last half second in the recording, and continues like the
# recording from the present position. A useful model predicts better.

K, HORIZON = 10, 20


def replay(past: np.ndarray) -> np.ndarray:
    """Return the continuation of the best match of the last K samples, (HORIZON, D)."""
    starts = range(len(training) - K - HORIZON)
    distances = [np.sum((training[i : i + K] - past) ** 2) for i in starts]
    end = int(np.argmin(distances)) + K
    return training[end : end + HORIZON] - training[end - 1] + past[-1]


errors: dict[str, list[float]] = {name: [] for name in (*models, "replay")}
for first in range(0, len(test) - K - HORIZON, 10):
    past = test[first : first + K]
    truth = test[first + K : first + K + HORIZON]
    predictions = {name: m.predict(past, HORIZON).values for name, m in models.items()}
    predictions["replay"] = replay(past)
    for name, prediction in predictions.items():
        squares = np.sum((prediction - truth) ** 2, axis=1)
        errors[name].append(float(np.sqrt(np.mean(squares))))

figure, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
ax.boxplot(
    [1e3 * np.array(e) for e in errors.values()],
    orientation="horizontal",
    tick_labels=list(errors),
    showfliers=False,
)
ax.set(xlabel="prediction error of the next second (mm)")
plt.show()
for name, values in errors.items():
    print(f"{name:8} {1e3 * np.sqrt(np.mean(np.square(values))):5.1f} mm")

# %%
# `ProMP` is an estimator, too, which learns from windows; `AlignedProMP`, `PeriodicDMP` and
# `PeriodicGP` are methods of the benchmark, which learn from lists of arrays at 20 Hz.
# `fmp-drake benchmark` scores these and other methods on the recordings in a folder.

windows = np.lib.stride_tricks.sliding_window_view(training, 120, axis=0)[::4]
promp = ProMP(frequencies=5, n_components=20).fit(windows.transpose(0, 2, 1))
print("predicted by ProMP:", promp.predict(test[:K], HORIZON).values.shape)
