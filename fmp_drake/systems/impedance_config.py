"""The settings of the impedance controller, loadable from YAML."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fmp_drake.errors import StationError
from fmp_drake.systems.impedance_law import ImpedanceGains


@dataclass(kw_only=True)
class ImpedanceConfig:
    """Settings of `OperationalSpaceImpedanceController`.

    T is the task frame (the board), E the end effector. Values are checked when
    they are used, because loading YAML does not construct anew.

    Parameters
    ----------
    translational_stiffness : list of 3 floats
        Along T's x, y and z (the board's normal), N/m. Soft along the normal: the
        feed-forward force presses, and an uneven board is forgiven.
    rotational_stiffness : list of 3 floats
        About T's x, y and z, Nm/rad. Soft about the normal, where the eraser may
        turn as it likes.
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
        front of its base, and 100 at 0.7 m, where its elbow is nearly straight.
    characteristic_length : float
        Length that makes rotational inertia comparable to mass, m.
    control_period : float
        Time between updates of the torque, s.
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
    max_effective_mass: float = 100.0
    characteristic_length: float = 0.25
    control_period: float = 0.001

    def check(self) -> None:
        """Check every value.

        Raises
        ------
        StationError
            If a value is not finite, has the wrong length or the wrong sign.
        """
        for name in ("translational_stiffness", "rotational_stiffness"):
            if min(_three(name, getattr(self, name))) <= 0:
                raise StationError(
                    f"{name} must be positive in all 3 directions, got "
                    f"{getattr(self, name)}; use a small number for a free direction"
                )
        _three("orientation", self.orientation)
        for name in ("posture_frequency", "posture_damping_ratio"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise StationError(f"{name} must be finite and at least 0, got {value}")
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
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise StationError(
                    f"{name} must be finite and greater than 0, got {value}"
                )

    def gains(self) -> ImpedanceGains:
        """Check the settings and turn them into what the law takes.

        Returns
        -------
        ImpedanceGains
            With the stiffness diagonal in T.
        """
        self.check()
        return ImpedanceGains(
            stiffness=np.diag(
                [*self.rotational_stiffness, *self.translational_stiffness]
            ),
            damping_ratio=self.damping_ratio,
            posture_frequency=self.posture_frequency,
            posture_damping_ratio=self.posture_damping_ratio,
            max_rotation_error=self.max_rotation_error,
            max_translation_error=self.max_translation_error,
            max_posture_error=self.max_posture_error,
            max_effective_mass=self.max_effective_mass,
            characteristic_length=self.characteristic_length,
        )

    def desired_rotation(self) -> NDArray[np.float64]:
        """Compute the desired orientation.

        Returns
        -------
        array, shape (3, 3)
            R_TE.
        """
        self.check()
        R_TE: NDArray[np.float64] = Rotation.from_euler(
            "xyz", self.orientation
        ).as_matrix()
        return R_TE


def _three(name: str, values: Sequence[float]) -> list[float]:
    """Return the values if they are three finite numbers."""
    given = np.asarray(values, dtype=float)
    if given.shape != (3,) or not np.all(np.isfinite(given)):
        raise StationError(f"{name} must be 3 finite numbers, got {values}")
    return [float(value) for value in given]
