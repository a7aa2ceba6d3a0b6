"""Synthetic recordings with orientation and force."""

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.primitives import Demonstration, add_orientation

RATE = 1.84  # rad/s


def demonstration(*, height, force=None, tilt=None):
    """Return 90 s of a hand that stirs, or polishes with a pulsing force."""
    t = np.arange(0, 90, 0.05)
    size = 0.06 * (1 + 0.1 * np.sin(0.3 * t))
    values = [size * np.cos(RATE * t), size * np.sin(RATE * t), np.full_like(t, height)]
    channels, units = ["x", "y", "z"], ["m", "m", "m"]
    if force is not None:
        values.append(force[0] + force[1] * np.cos(RATE * t))
        channels.append("force")
        units.append("N")
    shown = Demonstration(
        time=t,
        values=np.column_stack(values),
        channels=channels,
        units=units,
        frame="board",
    )
    if tilt is None:
        return shown
    lean = tilt * np.column_stack([np.sin(RATE * t), np.cos(RATE * t), 0 * t])
    down = Rotation.from_euler("x", np.pi)
    return add_orientation(shown, Rotation.from_rotvec(lean) * down)
