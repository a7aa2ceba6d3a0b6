"""Everything that stays the same from update to update of the impedance controller."""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import inlined
from fmp_drake.systems.impedance.algebra import Pose
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.friction import FrictionConfig, SigmoidFriction
from fmp_drake.systems.impedance.limits import JointLimits

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ImpedanceSettings:
    """What an arm's controller is set to, apart from its joints: of one size for any arm.

    Attributes
    ----------
    config : ImpedanceConfig
    stiffness : array, shape (6, 6)
        K where no port brings another, in T.
    R_TE : array, shape (3, 3)
        The desired orientation where no port brings another.
    X_WT : Pose
        The task frame where no port brings another.
    engage_height : float
        Height over T's plane below which the normal force comes in, m.
    """

    config: ImpedanceConfig
    stiffness: Array
    R_TE: Array
    X_WT: Pose
    engage_height: float


def settings_of(
    config: ImpedanceConfig,
    *,
    X_WT: Pose,
    engage_height: float,
) -> NDArray[Any]:
    """Check a configuration and complete it.

    Returns
    -------
    array, shape (1,)
        The values of `ImpedanceSettings`, of the type `LAYOUT`.

    Raises
    ------
    ControllerError
        If a value cannot be used.
    """
    settings = ImpedanceSettings(
        # The lists of the friction are as long as the arm: see `joint_settings`.
        config=replace(config, friction_compensation=FrictionConfig()),
        stiffness=config.stiffness(),
        R_TE=config.desired_rotation(),
        X_WT=X_WT,
        engage_height=engage_height,
    )
    return np.array([values_of(settings)])


class JointSettings(NamedTuple):
    """What a controller is set to for each joint of its arm.

    Attributes
    ----------
    limits : JointLimits
    friction : SigmoidFriction
        What is compensated; zero where the compensation is not enabled.
    q_posture : array, shape (n,)
        rad.
    """

    limits: JointLimits
    friction: SigmoidFriction
    q_posture: Array


def joint_settings(
    config: ImpedanceConfig, *, limits: JointLimits, q_posture: Array
) -> Array:
    """Check a configuration for an arm of n joints, and return `JointSettings` as rows.

    Returns
    -------
    array, shape (9, n)

    Raises
    ------
    ControllerError
        If the friction to be compensated is not that of n joints.
    """
    n = len(q_posture)
    friction = SigmoidFriction(np.zeros(n), np.zeros(n), np.zeros(n))
    if config.friction_compensation.enabled:
        friction = SigmoidFriction.of(config.friction_compensation, n=n)
    return np.stack([*limits, *friction, q_posture])


@inlined
def of_joints(rows: Array) -> JointSettings:
    """Read what `joint_settings` returned."""
    return JointSettings(
        JointLimits(rows[0], rows[1], rows[2], rows[3], rows[4]),
        SigmoidFriction(rows[5], rows[6], rows[7]),
        rows[8],
    )


def values_of[C](settings: C) -> C:
    """Return a NumPy record with the fields of a dataclass of numbers.

    It is a copy. Numbers become floats, lists arrays, dataclasses and named tuples
    records, so that compiled functions see the same types every time.

    Examples
    --------
    >>> from fmp_drake.systems.impedance.supervision import WatchdogConfig
    >>> float(values_of(WatchdogConfig(max_age=1)).max_age)
    1.0
    """
    record: Any = np.array([_contents(settings)], _dtype(settings))
    return record.view(np.recarray)[0]


def _parts(value: Any) -> dict[str, Any] | None:
    """Return the named parts of a value that has some."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return value._asdict() if hasattr(value, "_asdict") else None


def _contents(value: Any) -> Any:
    parts = _parts(value)
    return value if parts is None else tuple(map(_contents, parts.values()))


def _dtype(value: Any) -> np.dtype[Any]:
    parts = _parts(value)
    if parts is not None:
        return np.dtype([(name, _dtype(part)) for name, part in parts.items()])
    kind = bool if isinstance(value, bool) else float
    return np.dtype((kind, np.shape(value)))


LAYOUT = settings_of(
    ImpedanceConfig(), X_WT=Pose(np.eye(3), np.zeros(3)), engage_height=1.0
).dtype
"""The type of what `settings_of` returns."""
