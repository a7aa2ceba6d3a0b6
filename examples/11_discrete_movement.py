"""
Discrete movements
==================

The first footnote of the paper: a movement with a start and a goal, together with its mirror
image in time, is one period of a rhythmic movement. So the same mathematics learns reaching, with
new starts, goals and via-points.
"""

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.primitives import Demonstration, DiscreteMovementPrimitive, ViaPoint

# %%
# Eight demonstrations
# --------------------
# A hand moves from the left to the right over an obstacle. Duration, start and goal vary.

rng = np.random.default_rng(1)


def reach() -> Demonstration:
    """Return a reaching movement in the plane, m."""
    time = np.linspace(0, rng.uniform(1.2, 1.8), 60)
    s = time / time[-1]
    smooth = s**3 * (10 - 15 * s + 6 * s**2)
    start, goal = rng.normal([0, 0], 0.02, 2), rng.normal([0.5, 0.1], 0.02, 2)
    height = rng.normal(0.2, 0.02)
    arch = np.stack([0 * s, height * np.sin(np.pi * smooth) ** 2], axis=1)
    return Demonstration(
        time=time, values=start + smooth[:, None] * (goal - start) + arch
    )


demonstrations = [reach() for _ in range(8)]
primitive = DiscreteMovementPrimitive(explained_variance=0.999).fit(demonstrations)
print(f"mean duration {primitive.duration_:.2f} s")

# %%
# New starts, goals and via-points
# --------------------------------
# A via-point has a phase, which is 0 at the start and 1 at the goal.

nominal = primitive.rollout(start=[0.0, 0.0], goal=[0.5, 0.1])
new_goal = primitive.rollout(start=[-0.05, 0.08], goal=[0.58, 0.18])
via_point = primitive.rollout(
    start=[0.0, 0.0],
    goal=[0.5, 0.1],
    via=[ViaPoint(phase=0.5, values=[0.25, 0.32])],
    rate=1000.0,
)

figure, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
for demonstration in demonstrations:
    ax.plot(*demonstration.values.T, color="0.8")
for path, label in (
    (nominal, "as demonstrated"),
    (new_goal, "new start and goal"),
    (via_point, "through a via-point"),
):
    ax.plot(*path[:, 0].T, linewidth=2, label=label)
ax.plot(0.25, 0.32, "k+", markersize=12)
ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
ax.legend()
plt.show()

# %%
# Start, goal and via-point are met exactly, and the movement is at rest at start and goal:

distance = np.min(np.linalg.norm(via_point[:, 0] - [0.25, 0.32], axis=1))
print(f"passes the via-point at {1e3 * distance:.2f} mm")
print(f"speed at the end {np.linalg.norm(via_point[-1, 1]):.1e} m/s")
assert distance < 0.001
assert np.allclose(new_goal[[0, -1], 0], [[-0.05, 0.08], [0.58, 0.18]], atol=1e-6)
