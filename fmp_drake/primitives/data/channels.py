"""Names, indices, roles and scales of channels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fmp_drake.errors import FmpError, SkillError
from fmp_drake.numeric import GREATEST, Array, check_type, finite_array, is_whole

POSITION_CHANNELS = ("x", "y", "z")
# Rotation vector, rad; see `fmp_drake.primitives.data.orientation`.
ROTATION_CHANNELS = ("rx", "ry", "rz")
# Unit quaternion of a recorded orientation.
QUATERNION_CHANNELS = ("qx", "qy", "qz", "qw")
# Euler angles of a recorded orientation, R = Rz(yaw) Ry(pitch) Rx(roll).
EULER_CHANNELS = ("roll", "pitch", "yaw")

# A normal force, and the components of a measured force, N.
FORCE_CHANNEL = "force"
FORCE_COMPONENTS = ("force_x", "force_y", "force_z")

# Change of a channel relative to its values, up to which it is a rounding error.
_ROUNDING = 1e-9

Quaternion = tuple[float, float, float, float]
ChannelScales = Literal["units"] | ArrayLike


def listed(items: Sequence[Any], *, most: int = 12) -> str:
    """Return names or numbers separated by commas; only the first ones of very many."""
    more = f" and {len(items) - most} more" * (len(items) > most)
    return f"{', '.join(map(str, items[:most]))}{more}"


def default_channels(count: int) -> tuple[str, ...]:
    """Return the names of unnamed channels: x, y, z, or c0, c1 and so on."""
    if count <= len(POSITION_CHANNELS):
        return POSITION_CHANNELS[:count]
    return tuple(f"c{i}" for i in range(count))


def channel_indices(
    channels: Sequence[str | int] | None,
    names: Sequence[str],
    *,
    error: type[FmpError] = SkillError,
) -> list[int]:
    """Return the indices of channels given by name or index; all where None."""
    if channels is None:
        return list(range(len(names)))
    if isinstance(channels, str):
        channels = [channels]
    if not isinstance(channels, Sequence | np.ndarray):
        raise error(f"channels is {channels!r}; give a list of names or indices.")
    out: list[int] = []
    for channel in channels:
        if isinstance(channel, str) and channel in names:
            out.append(names.index(channel))
        elif is_whole(channel) and 0 <= int(channel) < len(names):
            out.append(int(channel))
        else:
            raise error(
                f"there is no channel {channel!r}; the channels are "
                f"{', '.join(names)} (0 to {len(names) - 1})."
            )
    if not out or len(set(out)) != len(out):
        raise error(f"the channels {channels} are empty or repeat.")
    return out


@dataclass(frozen=True, kw_only=True)
class ChannelRoles:
    """Indices of position, rotation and normal force among the channels of a skill.

    Attributes
    ----------
    position : tuple of 3 ints
        Of x, y and z in m. Over a curved surface they are the coordinates along it and the
        height over it.
    rotation : tuple of 3 ints or None
        Of rx, ry and rz in rad: the rotation vector phi of R = exp([phi]x) R_ref.
    reference : tuple of 4 floats or None
        Quaternion (x, y, z, w) of R_ref.
    force : int or None
        Of the normal force in N.

    Examples
    --------
    >>> roles = channel_roles(["x", "y", "z", "force"], ["m", "m", "m", "N"])
    >>> roles.force, roles.count
    (3, 4)
    """

    position: tuple[int, int, int]
    rotation: tuple[int, int, int] | None = None
    reference: Quaternion | None = None
    force: int | None = None

    @property
    def count(self) -> int:
        """Number of channels."""
        return 3 + 3 * (self.rotation is not None) + (self.force is not None)


def channel_roles(
    channels: Sequence[str],
    units: Sequence[str],
    *,
    rotation_reference: Quaternion | None = None,
) -> ChannelRoles:
    """Return the roles of channels; each channel must have one.

    Parameters
    ----------
    channels, units : sequence of str
        Names and units, in the same order.
    rotation_reference : tuple of float, optional
        Quaternion (x, y, z, w) of the rotation channels.

    Raises
    ------
    SkillError
        Where a position is missing, a channel has no role, a unit does not fit, or there is
        a rotation without its reference.
    """
    for name, value in (("channels", channels), ("units", units)):
        check_type(value, name, Sequence, error=SkillError)
    if len(channels) != len(units):
        raise SkillError(
            f"there are {len(channels)} channels and {len(units)} units; give one unit per "
            "channel."
        )
    expected = dict.fromkeys(POSITION_CHANNELS, "m")
    expected |= dict.fromkeys(ROTATION_CHANNELS, "rad")
    expected[FORCE_CHANNEL] = "N"
    for channel, unit in zip(channels, units, strict=True):
        if channel not in expected:
            raise SkillError(
                f"channel {channel} has no role; a robot plays "
                f"{', '.join(f'{name} ({unit})' for name, unit in expected.items())}. "
                "Learn it without this channel (--columns or Demonstration.select chooses)."
            )
        if unit != expected[channel]:
            raise SkillError(
                f"channel {channel} is in {unit}; expected {expected[channel]}."
            )
    if missing := [name for name in POSITION_CHANNELS if name not in channels]:
        raise SkillError(
            f"the channels are {', '.join(channels)}; a robot needs "
            f"{', '.join(missing)} as well."
        )
    index = list(channels).index
    rotation = None
    if present := [name for name in ROTATION_CHANNELS if name in channels]:
        if len(present) < 3 or rotation_reference is None:
            raise SkillError(
                f"rotation is given by {', '.join(present)}; expected rx, ry and rz with "
                "their reference, as `add_orientation` makes them."
            )
        rx, ry, rz = (index(name) for name in ROTATION_CHANNELS)
        rotation = (rx, ry, rz)
    x, y, z = (index(name) for name in POSITION_CHANNELS)
    return ChannelRoles(
        position=(x, y, z),
        rotation=rotation,
        reference=rotation_reference if rotation else None,
        force=index(FORCE_CHANNEL) if FORCE_CHANNEL in channels else None,
    )


def channel_scales(scales: ChannelScales, values: Array, units: Sequence[str]) -> Array:
    """Return the number that each channel is divided by before the fit, shape (D,).

    Parameters
    ----------
    scales : "units" or array_like, shape (D,)
        "units": 1 where all channels share one unit; else the standard deviation
        of all channels of a unit together (1 where they change by rounding errors at most).
    values : ndarray, shape (..., D)
    units : sequence of str
        Of each channel.
    """
    d = values.shape[-1]
    if isinstance(scales, str):
        if scales != "units":
            raise SkillError(f"scales is {scales!r}; give 'units' or {d} numbers.")
        out = np.ones(d)
        if len(set(units)) > 1:
            flat = values.reshape(-1, d)
            variances = flat.var(axis=0)
            for unit in set(units):
                same = [i for i in range(d) if units[i] == unit]
                spread = float(np.sqrt(variances[same].mean()))
                least = _ROUNDING * float(np.max(np.abs(flat[:, same])))
                out[same] = spread if spread > least else 1.0
        return out
    out = finite_array(scales, "the scales", (d,))
    if not np.all(out > 1 / GREATEST):
        raise SkillError(f"scales is {scales}; expected {d} positive numbers.")
    return out.copy()
