"""
A movement that knows its phase
===============================

From a recording of four cycles or more, the phase model learns a mean cycle, a phase of varying
velocity, and a residual. It gives the period, the phase of a movement, and a prediction with a
calibrated covariance.
"""

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import models_dir

recording = Demonstration.load(models_dir() / "demonstrations" / "eight.npz")
uniform = recording.resample(20.0)
cut = int(0.8 * len(uniform.values))
seen = Demonstration(
    time=uniform.time[:cut],
    values=uniform.values[:cut],
    channels=uniform.channels,
    units=uniform.units,
)
skill = FourierMovementPrimitive().fit(seen)
print(f"one cycle takes {skill.period_:.2f} s")

# %%
# Where in the cycle
# ------------------
# Of samples that were not learned from. The phase runs from 0 to 2 pi, over and over.

unseen = uniform.values[cut:]
phase = skill.phase(unseen)
time = np.arange(len(unseen)) / skill.rate

figure, (above, below) = plt.subplots(
    2, 1, figsize=(8, 4.5), layout="constrained", sharex=True
)
above.plot(time, 1e3 * unseen[:, :2], label=["x", "y"])
above.set_ylabel("mm")
above.legend(loc="upper right")
below.plot(time, np.mod(phase, 2 * np.pi), ".", markersize=3)
below.set(xlabel="time (s)", ylabel="phase (rad)", ylim=(0, 2 * np.pi))
plt.show()

# %%
# What comes next
# ---------------
# The next second, from half a second: expected (orange) with its 95 % ellipses, and what the
# person did (black).

figure, ax = plt.subplots(figsize=(5, 5), layout="constrained")
ax.plot(*seen.values.T[[1, 0]], color="0.9", linewidth=0.5)
angle = np.linspace(0, 2 * np.pi, 40)
circle = 2.45 * np.stack([np.cos(angle), np.sin(angle)])
for first in range(0, 120, 40):
    past, truth = unseen[first : first + 10], unseen[first + 10 : first + 30]
    ahead = skill.predict(past, len(truth))
    ax.plot(*truth.T[[1, 0]], "k", linewidth=2)
    ax.plot(*ahead.values.T[[1, 0]], color="tab:orange", linewidth=2)
    for i in range(4, 20, 5):
        root = np.linalg.cholesky(ahead.covariances[i][:2, :2])
        x, y = ahead.values[i, :2, None] + root @ circle
        ax.plot(y, x, color="tab:orange", linewidth=0.7)
    off = np.sqrt(np.mean(np.sum((ahead.values - truth) ** 2, axis=1)))
    print(f"after {first / 20:.0f} s: the next second is off by {1e3 * off:.1f} mm rms")
ax.set(xlabel="y (m)", ylabel="x (m)", aspect="equal")
ax.invert_xaxis()
plt.show()
