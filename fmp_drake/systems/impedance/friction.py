"""The friction of the arm's joints."""

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled
from fmp_drake.errors import ControllerError

Array = NDArray[np.float64]


@dataclass(kw_only=True)
class FrictionConfig:
    """A sigmoid of the joint velocity, and the Panda's parameters of it.

    They were identified on a Panda by Gaz et al. [1]_, table I.

    Attributes
    ----------
    enabled : bool
    gain : float
        Part of the friction that is meant: 1 for the arm's own, somewhat less to
        compensate it, as too much makes the joints run away.
    height : list of floats
        φ1 of each joint, Nm.
    slope : list of floats
        φ2, s/rad.
    shift : list of floats
        φ3, rad/s.

    References
    ----------
    .. [1] C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "Dynamic
       identification of the Franka Emika Panda robot with retrieval of feasible
       parameters using penalty-based optimization", IEEE RA-L 4(4), 2019.

    Examples
    --------
    >>> config = FrictionConfig(enabled=True, gain=0.9)
    >>> len(config.height)
    7
    """

    enabled: bool = False
    gain: float = 1.0
    height: list[float] = field(
        default_factory=lambda: [
            0.54615,
            0.87224,
            0.64068,
            1.2794,
            0.83904,
            0.30301,
            0.56489,
        ]
    )
    slope: list[float] = field(
        default_factory=lambda: [5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336]
    )
    shift: list[float] = field(
        default_factory=lambda: [
            0.039533,
            0.025882,
            -0.04607,
            0.036194,
            0.026226,
            -0.021047,
            0.0035526,
        ]
    )


class SigmoidFriction(NamedTuple):
    """The parameters of the joints' friction, see `friction_torque`.

    Attributes
    ----------
    height, slope, shift : array, shape (n,)
        φ1 in Nm, φ2 in s/rad and φ3 in rad/s.
    """

    height: Array
    slope: Array
    shift: Array

    @classmethod
    def of(cls, config: FrictionConfig, *, n: int) -> Self:
        """Check a configuration for an arm of n joints.

        Raises
        ------
        ControllerError
            If a list has not n finite numbers, or one has the wrong sign.
        """
        values = []
        for name in ("height", "slope", "shift"):
            value = np.array(getattr(config, name), dtype=float)
            if value.shape != (n,) or not np.isfinite(value).all():
                raise ControllerError(
                    f"friction.{name} must be {n} finite numbers, one per joint, got "
                    f"{getattr(config, name)}"
                )
            if name != "shift" and value.min() < 0:
                raise ControllerError(
                    f"friction.{name} must not be negative, got {value}"
                )
            values.append(value)
        if not (np.isfinite(config.gain) and config.gain >= 0):
            raise ControllerError(
                f"friction.gain must be finite and at least 0, got {config.gain}"
            )
        return cls(config.gain * values[0], values[1], values[2])


@compiled
def friction_torque(friction: SigmoidFriction, v: Array) -> Array:
    """Return the friction torque, shape (n,) in Nm, at velocities in rad/s.

    ``τ = φ1 / (1 + exp(−φ2 (v + φ3))) − φ1 / (1 + exp(−φ2 φ3))``: zero at rest,
    against the motion where it is subtracted, and bounded by φ1.
    """
    # 1 / (1 + exp(−x)) = (1 + tanh(x / 2)) / 2, which does not overflow.
    half = 0.5 * friction.slope
    moving = np.tanh(half * (v + friction.shift))
    return 0.5 * friction.height * (moving - np.tanh(half * friction.shift))
