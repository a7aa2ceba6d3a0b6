"""What is measured of the end effector, as a function of arrays."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.systems.impedance.algebra import Pose, cross, relative
from fmp_drake.systems.impedance.packing import unpack
from fmp_drake.systems.impedance.settings import LAYOUT
from fmp_drake.systems.impedance.target import task_error

Array = NDArray[np.float64]


@compiled
def measured_motion(
    settings: NDArray[np.uint8], packed: Array, X_WE: Array, V_WE: Array
) -> Array:
    """Return where the end effector is in T, how it moves, and what is left to its target.

    Parameters
    ----------
    settings : array of bytes
        What `settings_of` returned.
    packed : array, shape (107,)
        The inputs, see `unpack`.
    X_WE : array, shape (4, 3)
        Transposed R_WE, and below it p_WE in m.
    V_WE : array, shape (6,)
        Rotation first, rad/s and m/s.

    Returns
    -------
    array, shape (12,)
        p_TE in m, its derivative in T in m/s, and `task_error`.
    """
    inputs = unpack(packed, settings.view(LAYOUT)[0], 0.0)
    R_WT, frame = inputs.X_WT.R, inputs.frame_twist
    X_TE = relative(inputs.X_WT, Pose(np.ascontiguousarray(X_WE[:3].T), X_WE[3]))
    motion = np.empty(12)
    motion[:3] = X_TE.p
    motion[3:6] = R_WT.T @ V_WE[3:] - frame[3:] - cross(frame[:3], X_TE.p)
    motion[6:] = task_error(X_TE, inputs.target.X)
    return motion
