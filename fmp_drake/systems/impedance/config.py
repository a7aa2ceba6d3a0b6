"""Settings of the impedance controller, loadable from YAML."""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array
from fmp_drake.settings import bounded, check_settings
from fmp_drake.systems.impedance.force_control import ForceControlConfig
from fmp_drake.systems.impedance.joints import FrictionConfig, JointWallConfig
from fmp_drake.systems.impedance.stiffness import (
    CovarianceStiffnessConfig,
    EnergyTankConfig,
)
from fmp_drake.systems.impedance.supervision import WatchdogConfig

_FREE_DIRECTION = "use a small number for a free direction"


@dataclass(kw_only=True)
class ImpedanceConfig:
    """Settings of `OperationalSpaceImpedanceController`.

    T is the task frame (the board), E the end effector. Values are checked when they
    are used, because loading YAML does not call the constructor.

    Parameters
    ----------
    translational_stiffness : list of 3 floats
        Along T's x, y and z (the board's normal), N/m. Soft along the normal: the
        normal force acts there, and an uneven board changes it little.
    rotational_stiffness : list of 3 floats
        About T's x, y and z, Nm/rad. Soft about the normal, where the eraser may
        rotate freely.
    orientation : list of 3 floats
        Roll, pitch, yaw of the desired R_TE, rad: Rz(yaw) Ry(pitch) Rx(roll).
        The default is diag(1, -1, -1), the tool pointing into the board.
    damping_ratio : float
        Of every mode of the end effector; 1 is critical.
    posture_frequency : float
        Natural frequency of the motion inside the nullspace, rad/s.
    posture_damping_ratio : float
        Of the motion inside the nullspace.
    max_translation_error, max_rotation_error, max_posture_error : float
        Greatest errors to which the stiffness responds, m, rad and rad. They bound the
        force, and with the damping the speed, of a start far from the target.
    max_torque_rate : float or None
        Fastest change of any joint torque, Nm/s. None means the robot's rate in a station,
        and no limit for a controller on its own.
    max_effective_mass : float
        Largest inertia that the law ascribes to the end effector, kg: it bounds the
        torque at singularities. Arms with a reach of 0.9 m have less than 60 in the
        middle of their workspace, and 100 where the elbow is nearly straight. Where it is
        bounded, the posture's torque disturbs the tool.
    characteristic_length : float
        Length that makes rotational inertia comparable to mass, m.
    control_period : float
        Time between updates of the torque, s. Stations check that their arm is stable with it.
    stiffness_time_constant : float
        Of the low-pass filter of a stiffness that changes while running, s.
    walls : JointWallConfig
    watchdog : WatchdogConfig
    force_control : ForceControlConfig
    covariance_stiffness : CovarianceStiffnessConfig
    tank : EnergyTankConfig
    friction_compensation : FrictionConfig
        The friction of the joints that is compensated, from the measured velocity.

    Examples
    --------
    >>> config = ImpedanceConfig(translational_stiffness=[800.0, 800.0, 100.0])
    >>> config.stiffness().diagonal().tolist()
    [30.0, 30.0, 3.0, 800.0, 800.0, 100.0]
    >>> config.damping_ratio = -1.0
    >>> config.stiffness()
    Traceback (most recent call last):
    ...
    fmp_drake.errors.SystemsError: damping_ratio is -1.0; it must be positive.
    """

    translational_stiffness: list[float] = bounded(
        [1500.0, 1500.0, 200.0], above=0, hint=_FREE_DIRECTION
    )
    rotational_stiffness: list[float] = bounded(
        [30.0, 30.0, 3.0], above=0, hint=_FREE_DIRECTION
    )
    orientation: list[float] = bounded(
        [math.pi, 0.0, 0.0], least=-6.3, most=6.3, hint="in rad, not degrees"
    )
    damping_ratio: float = bounded(1.0, above=0)
    posture_frequency: float = bounded(5.0, least=0)
    posture_damping_ratio: float = bounded(1.0, least=0)
    max_translation_error: float = bounded(0.1, above=0)
    max_rotation_error: float = bounded(0.5, above=0)
    max_posture_error: float = bounded(0.5, above=0)
    max_torque_rate: float | None = bounded(None, above=0)
    max_effective_mass: float = bounded(300.0, above=0)
    characteristic_length: float = bounded(0.25, above=0)
    control_period: float = bounded(0.001, least=0.0001, most=0.02)
    stiffness_time_constant: float = bounded(0.05, least=0)
    walls: JointWallConfig = field(default_factory=JointWallConfig)
    watchdog: WatchdogConfig = field(default_factory=WatchdogConfig)
    force_control: ForceControlConfig = field(default_factory=ForceControlConfig)
    covariance_stiffness: CovarianceStiffnessConfig = field(
        default_factory=CovarianceStiffnessConfig
    )
    tank: EnergyTankConfig = field(default_factory=EnergyTankConfig)
    friction_compensation: FrictionConfig = field(
        default_factory=lambda: FrictionConfig(gain=0.9)
    )

    def stiffness(self) -> Array:
        """Check the settings and compute the stiffness.

        Returns
        -------
        array, shape (6, 6)
            K, in T, rotations first: Nm/rad and N/m.
        """
        check_settings(self, SystemsError)
        return np.diag([*self.rotational_stiffness, *self.translational_stiffness])

    def desired_rotation(self) -> Array:
        """Check the settings and compute the desired orientation.

        Returns
        -------
        array, shape (3, 3)
            R_TE.
        """
        check_settings(self, SystemsError)
        return Rotation.from_euler("xyz", self.orientation).as_matrix()
