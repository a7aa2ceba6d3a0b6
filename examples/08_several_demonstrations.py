"""
Several demonstrations with weights
===================================

A list of recordings is learned together. Each recording may have a weight. Nothing needs to be
aligned, because a window may start anywhere.
"""

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.plots import draw_samples_in_plane
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive

# %%
# Three people draw ellipses
# --------------------------
# The ellipses differ in size, tempo and start. Any `(N, D)` array with its times is a
# demonstration.

rng = np.random.default_rng(3)
time = np.arange(0.0, 60.0, 0.05)


def ellipse(size: float, period: float, wobble: float) -> Demonstration:
    """Return a minute of ellipses, in metres, with a tempo that varies."""
    tempo = 1 + 0.1 * np.sin(2 * np.pi * time / 17 + rng.uniform(0, 6))
    phase = rng.uniform(0, 6) + np.cumsum(2 * np.pi / period * tempo) * 0.05
    drift = wobble * np.sin(2 * np.pi * time / 13)
    path = size * np.stack([np.sin(phase), 0.5 * np.cos(phase)], axis=1)
    return Demonstration(
        time=time,
        values=path + drift[:, None] + rng.normal(0, 3e-4, path.shape),
        channels=("x", "y"),
        units=("m", "m"),
        frame="board",
    )


people = [ellipse(0.10, 3.0, 0.0), ellipse(0.12, 3.4, 0.0), ellipse(0.20, 4.5, 0.02)]

# %%
# Equal and weighted
# ------------------
# With equal weights the large ellipses are a third of the samples. The third person was in a
# hurry: with a tenth of the weight, their ellipses hardly occur. A mixture represents all
# ellipses; a phase model would learn the one that most recordings share.

equal = FourierMovementPrimitive(n_components=30, model="mixture").fit(people)
weighted = FourierMovementPrimitive(n_components=30, model="mixture").fit(
    people, weights=[1, 1, 0.1]
)
print(f"{equal.n_windows_} windows from {len(people)} recordings")


def width(skill: FourierMovementPrimitive) -> float:
    """Return the median half width of 400 samples, m."""
    return float(np.median(np.ptp(skill.sample(400), axis=1)[:, 0])) / 2


print(f"half width of a sample: {width(equal):.3f} m, {width(weighted):.3f} m")

figure, axes = plt.subplots(1, 2, figsize=(9, 4.5), layout="constrained", sharey=True)
for ax, skill, title in zip(
    axes, (equal, weighted), ("equal", "a tenth for the third"), strict=True
):
    draw_samples_in_plane(skill, n=12, demonstrations=people, ax=ax)
    ax.set_title(title, loc="left")
plt.show()
assert width(weighted) < width(equal)
