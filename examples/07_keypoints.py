"""
Keypoints: positions and velocities at given times
==================================================

A learned movement is a distribution over whole windows. It can be conditioned on any linear
function of a window: its start, a position at some time, a velocity. This is equation (13) of
the paper. It takes less than a millisecond for the start of a window, and some milliseconds
for new keypoints.
"""

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.plots import draw_demonstrations_in_plane
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, Keypoint
from fmp_drake.station import models_dir

recording = Demonstration.load(models_dir() / "demonstrations" / "eight.npz")
skill = FourierMovementPrimitive().fit(recording)

# %%
# The beginning of a window
# -------------------------
# Ten samples of a person's movement, half a second, are enough to predict how it continues.

observed = recording.resample(skill.rate).values[400:410]
continuation = skill.map_partial(observed)
print(f"component {continuation.component} explains it best")

# %%
# One point, at one time
# ----------------------
# At any phase of its cycle: after 2 seconds the movement is to be 2 cm beside the middle in y.
# The other channels are free. The result is the most probable window of the nearest component.

middle = recording.values.mean(axis=0)
point = Keypoint(step=2.0 * skill.rate, values=[middle[1] + 0.02], channels=["y"])
single = skill.map_keypoints([point])

# %%
# Several keypoints, and velocities
# ---------------------------------
# Each keypoint has a tolerance, a variance in squared units. Here the movement begins at the
# position of the person, and 3 s later its velocity in x is 0.

begin = Keypoint(step=0, values=observed[0], tolerance=1e-8)
rest = Keypoint(
    step=3.0 * skill.rate, values=[0.0], channels=["x"], derivative=1, tolerance=1e-4
)
double = skill.map_keypoints([begin, rest])

figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained", sharey=True)
for ax, mapping, title in zip(
    axes,
    (continuation, single, double),
    ("from ten samples", "y after 2 s", "start, and at rest in x after 3 s"),
    strict=True,
):
    draw_demonstrations_in_plane(recording, ax=ax)
    x, y, _ = skill.synthesize(mapping.weights).T
    ax.plot(y, x, color="tab:orange", linewidth=2)
    ax.set_title(title, loc="left")
axes[0].plot(*observed.T[[1, 0]], "k", linewidth=4)
axes[1].axvline(middle[1] + 0.02, color="k", linestyle=":")
plt.show()

# %%
# The keypoints are met, as closely as their tolerances require:

step = int(2.0 * skill.rate)
y = skill.synthesize(single.weights)[step, 1]
print(f"desired y = {middle[1] + 0.02:.4f} m, result {y:.4f} m")
velocity = skill.observation_rows([3.0 * skill.rate], channels=["x"], derivative=1)
print(f"speed in x after 3 s: {1e3 * (velocity @ double.weights)[0]:.1f} mm/s")
assert abs(y - middle[1] - 0.02) < 1e-3
assert np.abs(velocity @ double.weights)[0] < 0.02
