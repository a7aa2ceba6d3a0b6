"""The settings of the impedance controller, loadable from YAML."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fmp_drake.errors import ControllerError
from fmp_drake.systems.impedance.force_control import ForceControlConfig
from fmp_drake.systems.impedance.friction import FrictionConfig
from fmp_drake.systems.impedance.limits import JointWallConfig
from fmp_drake.systems.impedance.stiffness import (
    CovarianceStiffnessConfig,
    EnergyTankConfig,
)
from fmp_drake.systems.impedance.supervision import WatchdogConfig


@dataclass(kw_only=True)
class ImpedanceConfig:
    """Settings of `OperationalSpaceImpedanceController`.

    T is the task frame (the board), E the end effector. Values are checked when
    they are used, because loading YAML does not construct anew.

    Parameters
    ----------
    translational_stiffness : list of 3 floats
        Along T's x, y and z (the board's normal), N/m. Soft along the normal: the
        normal force presses, and an uneven board is forgiven.
    rotational_stiffness : list of 3 floats
        About T's x, y and z, Nm/rad. Soft about the normal, where the eraser may
        rotate as it likes.
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
        Longest errors that the stiffness sees, m, rad and rad. They bound the
        force, and with the damping the speed, of a start far from the target.
    max_torque_rate : float
        Fastest change of any joint torque, Nm/s. The default keeps a tenth below the
        1000 Nm/s at which Franka's robots stop.
    max_effective_mass : float
        Largest inertia that the law ascribes to the end effector, kg: it bounds the
        torque at singularities. The Panda has less than 60 between 0.3 and 0.6 m in
        front of its base, and 100 at 0.7 m, where its elbow is nearly straight. Where
        it is bounded, the posture pulls the tool away.
    characteristic_length : float
        Length that makes rotational inertia comparable to mass, m.
    control_period : float
        Time between updates of the torque, s.
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
    >>> config.check()
    Traceback (most recent call last):
    ...
    fmp_drake.errors.ControllerError: damping_ratio must be finite and greater than 0, \
got -1.0
    """

    translational_stiffness: list[float] = field(
        default_factory=lambda: [1500.0, 1500.0, 200.0]
    )
    rotational_stiffness: list[float] = field(default_factory=lambda: [30.0, 30.0, 3.0])
    orientation: list[float] = field(default_factory=lambda: [math.pi, 0.0, 0.0])
    damping_ratio: float = 1.0
    posture_frequency: float = 5.0
    posture_damping_ratio: float = 1.0
    max_translation_error: float = 0.1
    max_rotation_error: float = 0.5
    max_posture_error: float = 0.5
    max_torque_rate: float = 900.0
    max_effective_mass: float = 300.0
    characteristic_length: float = 0.25
    control_period: float = 0.001
    stiffness_time_constant: float = 0.05
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

    def check(self) -> None:
        """Check every value.

        Raises
        ------
        ControllerError
            If a value is not finite, has the wrong length or the wrong sign.
        """
        for name in ("translational_stiffness", "rotational_stiffness"):
            if min(_three(name, getattr(self, name))) <= 0:
                raise ControllerError(
                    f"{name} must be positive in all 3 directions, got "
                    f"{getattr(self, name)}; use a small number for a free direction"
                )
        _three("orientation", self.orientation)
        for name in (
            "posture_frequency",
            "posture_damping_ratio",
            "stiffness_time_constant",
        ):
            _number(name, getattr(self, name), positive=False)
        for name in (
            "damping_ratio",
            "max_translation_error",
            "max_rotation_error",
            "max_posture_error",
            "max_torque_rate",
            "max_effective_mass",
            "characteristic_length",
            "control_period",
        ):
            _number(name, getattr(self, name), positive=True)
        self._check_parts()

    def _check_parts(self) -> None:
        """Check the nested settings."""
        for part, not_positive in (
            ("walls", ()),
            ("watchdog", ()),
            ("force_control", ("proportional_gain", "contact_force")),
            ("covariance_stiffness", ()),
            ("tank", ("initial_energy", "capacity", "stored_fraction")),
        ):
            for name, value in vars(getattr(self, part)).items():
                if isinstance(value, float | int) and not isinstance(value, bool):
                    _number(f"{part}.{name}", value, positive=name not in not_positive)
        if self.tank.stored_fraction > 1 or self.walls.speed_fraction > 1:
            raise ControllerError(
                "tank.stored_fraction and walls.speed_fraction must be at most 1, got "
                f"{self.tank.stored_fraction} and {self.walls.speed_fraction}"
            )
        if self.tank.initial_energy > self.tank.capacity:
            raise ControllerError(
                f"tank.initial_energy must be at most tank.capacity, got "
                f"{self.tank.initial_energy} and {self.tank.capacity} J"
            )
        soft = self.covariance_stiffness
        if soft.max_stiffness < soft.min_stiffness or len(soft.axes) != 3:
            raise ControllerError(
                "covariance_stiffness must have 3 axes and max_stiffness at least "
                f"min_stiffness, got {soft}"
            )

    def stiffness(self) -> NDArray[np.float64]:
        """Check the settings and compute the stiffness.

        Returns
        -------
        array, shape (6, 6)
            K, in T, rotations first: Nm/rad and N/m.
        """
        self.check()
        return np.diag([*self.rotational_stiffness, *self.translational_stiffness])

    def desired_rotation(self) -> NDArray[np.float64]:
        """Compute the desired orientation.

        Returns
        -------
        array, shape (3, 3)
            R_TE.
        """
        self.check()
        return Rotation.from_euler("xyz", self.orientation).as_matrix()


def _three(name: str, values: Sequence[float]) -> list[float]:
    """Return the values if they are three finite numbers."""
    given = np.asarray(values, dtype=float)
    if given.shape != (3,) or not np.all(np.isfinite(given)):
        raise ControllerError(f"{name} must be 3 finite numbers, got {values}")
    return [float(value) for value in given]


def _number(name: str, value: float, *, positive: bool) -> None:
    """Refuse a value that is not finite or has the wrong sign."""
    if math.isfinite(value) and (value > 0 or (value == 0 and not positive)):
        return
    allowed = "greater than 0" if positive else "at least 0"
    raise ControllerError(f"{name} must be finite and {allowed}, got {value}")
