"""
A tool that tilts: orientation channels
=======================================

Orientations are learned as unwrapped rotation vectors relative to a reference: three channels
in addition to the position. The input may be quaternions of either order and with any signs; the
output is rotations.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    add_orientation,
    angular_velocity,
    skill_rotations,
)

# %%
# A recording with quaternions
# ----------------------------
# A scraper leans into its stroke. The quaternions change their signs at random, like those of
# some recorders.

rng = np.random.default_rng(0)
time = np.arange(0.0, 60.0, 0.05)
phase = np.cumsum(2 * np.pi / 3.0 * (1 + 0.08 * np.sin(time / 4))) * 0.05
position = np.stack([0.1 * np.sin(phase), 0.2 * np.cos(phase), 0 * phase], axis=1)
lean = Rotation.from_euler(
    "yx", np.stack([0.5 * np.cos(phase), 0.2 * np.sin(phase)], 1)
)
quaternions = lean.as_quat() * rng.choice([-1, 1], len(time))[:, None]

recording = add_orientation(
    Demonstration(
        time=time, values=position, channels=("x", "y", "z"), units=("m", "m", "m")
    ),
    quaternions,
    order="xyzw",
)
print("channels:", ", ".join(recording.channels))

# %%
# Learn and play six channels
# ---------------------------
# `scales` makes metres and radians comparable; by default it follows from the units of the
# channels.

skill = FourierMovementPrimitive(n_components=30).fit(recording)
motion = Player(skill).rollout(start=recording.values[0], duration=20.0)
values, rates = motion[:, 0], motion[:, 1]
rotations = skill_rotations(skill, values)
omega = angular_velocity(values[:, 3:], rates[:, 3:])

# %%
# The tool's axis, played (orange) and demonstrated (grey), and its angular speed:

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for orientation, color, label in (
    (lean, "0.7", "demonstrated"),
    (rotations, "tab:orange", "played"),
):
    axis = orientation.apply([0.0, 0.0, 1.0])
    left.plot(axis[:, 0], axis[:, 1], color=color, label=label)
left.set(
    xlabel="axis, x", ylabel="axis, y", aspect="equal", title="direction of the tool"
)
left.legend()
right.plot(np.linspace(0, 20, len(omega)), np.linalg.norm(omega, axis=1), "tab:orange")
right.set(xlabel="time (s)", ylabel="rad/s", title="angular speed")
plt.show()

angle = np.degrees(np.linalg.norm(rotations.as_rotvec(), axis=1).max())
demonstrated = np.degrees(lean.magnitude().max())
print(f"the tool leans by up to {angle:.1f} degrees; demonstrated {demonstrated:.1f}")
assert abs(angle - demonstrated) < 5
