"""What one update of the impedance controller is told."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.systems.impedance.law import ArmDynamics
from fmp_drake.systems.impedance.target import TaskTarget

Array = NDArray[np.float64]


class ArmMeasurement(NamedTuple):
    """The arm at one finite state.

    Attributes
    ----------
    q : array, shape (n,)
        rad.
    dynamics : ArmDynamics
    R_TE : array, shape (3, 3)
    p_TE : array, shape (3,)
        m.
    error : array, shape (6,)
        What `task_error` gives for the target as it comes in.
    """

    q: Array
    dynamics: ArmDynamics
    R_TE: Array
    p_TE: Array
    error: Array


class StepInputs(NamedTuple):
    """What came in at the ports; None where a port is not used.

    Attributes
    ----------
    target : TaskTarget
        Relative to T.
    jerk : array, shape (3,), or None
        How the target's acceleration goes on, m/s³, in T.
    wrench : array, shape (6,)
        Feed-forward, Nm and N, in T.
    finite : bool
        Whether every input besides the state is.
    turning : bool
        Whether the target's orientation may change.
    age : float or None
        Of the target, s.
    R_WT : array, shape (3, 3)
    p_WT : array, shape (3,)
        m.
    moving_frame : bool
        Whether T may move.
    frame_twist : array, shape (6,), or None
        V_WT in T's axes.
    frame_acceleration : array, shape (6,)
        A_WT in T's axes.
    stiffness : array, shape (6,) or (36,), or None
    covariance : array, shape (9,), or None
        m².
    normal_force : float or None
        N.
    elapsed : float
        Since the full update before, s.
    """

    target: TaskTarget
    jerk: Array | None
    wrench: Array
    finite: bool
    turning: bool
    age: float | None
    R_WT: Array
    p_WT: Array
    moving_frame: bool
    frame_twist: Array | None
    frame_acceleration: Array
    stiffness: Array | None
    covariance: Array | None
    normal_force: float | None
    elapsed: float
