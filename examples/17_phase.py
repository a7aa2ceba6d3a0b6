"""
Phase of a movement
===================

From a recording of about 1.5 cycles or more, the phase model learns a mean cycle, a phase of
varying velocity, and a residual. It gives the period, the phase of a movement, and a prediction
with a calibrated covariance.
"""

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import models_dir

recording = Demonstration.load(models_dir() / "demonstrations" / "eight.npz")
uniform = recording.resample(20.0)
cut = int(0.8 * len(uniform.values))
training = Demonstration(
    time=uniform.time[:cut],
    values=uniform.values[:cut],
    channels=uniform.channels,
    units=uniform.units,
)
skill = FourierMovementPrimitive().fit(training)
print(f"one cycle takes {skill.period_:.2f} s")

# %%
# Phase of held-out samples
# -------------------------
# In each cycle the phase runs from 0 to 2 pi.

test = uniform.values[cut:]
phase = skill.phase(test)
time = np.arange(len(test)) / skill.rate

figure, (above, below) = plt.subplots(
    2, 1, figsize=(8, 4.5), layout="constrained", sharex=True
)
above.plot(time, 1e3 * test[:, :2], label=["x", "y"])
above.set_ylabel("position (mm)")
above.legend(loc="upper right")
below.plot(time, np.mod(phase, 2 * np.pi), ".", markersize=3)
below.set(xlabel="time (s)", ylabel="phase (rad)", ylim=(0, 2 * np.pi))
plt.show()

# %%
# Prediction
# ----------
# The next second is predicted from half a second: its expectation with 95 % ellipses (orange), and
# the movement of the person (black).

figure, ax = plt.subplots(figsize=(5, 5), layout="constrained")
ax.plot(*training.values.T[[1, 0]], color="0.9", linewidth=0.5)
angle = np.linspace(0, 2 * np.pi, 40)
circle = 2.45 * np.stack([np.cos(angle), np.sin(angle)])
for first in range(0, 120, 40):
    past, truth = test[first : first + 10], test[first + 10 : first + 30]
    prediction = skill.predict(past, len(truth))
    ax.plot(*truth.T[[1, 0]], "k", linewidth=2)
    ax.plot(*prediction.values.T[[1, 0]], color="tab:orange", linewidth=2)
    for i in range(4, 20, 5):
        root = np.linalg.cholesky(prediction.covariances[i][:2, :2])
        x, y = prediction.values[i, :2, None] + root @ circle
        ax.plot(y, x, color="tab:orange", linewidth=0.7)
    error = np.sqrt(np.mean(np.sum((prediction.values - truth) ** 2, axis=1)))
    print(
        f"after {first / 20:.0f} s: error of the next second {1e3 * error:.1f} mm rms"
    )
ax.set(xlabel="y (m)", ylabel="x (m)", aspect="equal")
ax.invert_xaxis()
plt.show()
