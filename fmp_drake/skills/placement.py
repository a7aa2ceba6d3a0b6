"""Placement of demonstrations on the board of a scenario."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Mask, finite_array
from fmp_drake.primitives import Demonstration
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
    listed,
)
from fmp_drake.primitives.data.reading.columns import NO_POSITION, SEVERAL
from fmp_drake.primitives.data.reading.table import columns_option
from fmp_drake.primitives.data.windows import DEFAULT_RATE, cut_demonstrations
from fmp_drake.skills.contact import samples_in_bouts
from fmp_drake.skills.joint_recording import (
    EraserPath,
    FindRobot,
    RobotJoints,
)
from fmp_drake.skills.surface_fit import front_axis
from fmp_drake.skills.surface_placement import (
    BORDER,
    check_scale,
    extra_options,
)
from fmp_drake.station import Scenario
from fmp_drake.station.robots.robot import ListRobots

# Planes that are tried, and samples that are enough to compare them.
_TRIES = 1000
_SAMPLES = 2000
# Width of a path that an arm can follow, m.
_WIDTHS = (0.003, 3.0)
_GUESSES = {"millimetres": ("mm", 1e-3), "centimetres": ("cm", 1e-2)}
# Distance from the plane up to which a sample is on it, m.
_TOUCH = 0.01
# Samples that are farther from the plane than the movement and tell its side.
_LEAST_AWAY = 4
# Least fraction of the time on the board of an accepted placement.
_LEAST_TOUCHING = 0.2
# Recordings of one frame: greatest width of their union relative to the widest one, and least
# time on the common plane relative to that on separate planes, of all and of each recording.
# 39 of 40 unmoved groups of real or simulated recordings are within these limits.
_WIDER, _AS_LONG, _EACH = 1.1, 0.6, 0.2
# Tilt of the plane of a recording that is reported, degrees: lifted returns of strokes may have
# been taken for a part of the plane.
_TILT = 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Placement:
    """Similarity transform from the frame D of a demonstration to the board's frame B.

    p_BE = scale * R_BD p_DE + p_BD.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        R_BD.
    translation : ndarray, shape (3,)
        p_BD, m.
    scale : float
    touch : float
        Heights up to this one become 0, and greater ones are reduced by it, m: a hand
        does not keep a tool on the surface within a millimetre. 0 changes no height.
    touching : float
        Fraction of the samples on the surface.

    Examples
    --------
    >>> recorded = Demonstration(
    ...     time=np.arange(100) / 20, values=np.random.default_rng(0).random((100, 3))
    ... )
    >>> placement = Placement(rotation=np.eye(3), translation=np.array([0.0, 0.0, 0.1]))
    >>> (placement.apply(recorded).values - recorded.values)[0].round(6)
    array([0. , 0. , 0.1])
    """

    rotation: Array
    translation: Array
    scale: float = 1.0
    touch: float = 0.0
    touching: float = 0.0

    def apply(self, demonstration: Demonstration) -> Demonstration:
        """Return the demonstration in the frame of the board."""
        values = demonstration.values @ (self.scale * self.rotation).T
        values += self.translation
        if self.touch > 0:
            values[:, 2] = np.maximum(values[:, 2] - self.touch, 0.0)
        return replace(
            demonstration, values=values, channels=POSITION_CHANNELS, frame="board"
        )


def check_width(demonstration: Demonstration) -> None:
    """Refuse a path x, y, z of a width that no arm can follow, and suggest its unit.

    Raises
    ------
    DemonstrationError
        Where it is more than 3 m wide, or less than 3 mm.
    """
    width = float(
        np.max(np.ptp(demonstration.select(POSITION_CHANNELS).values, axis=0))
    )
    if width == 0 or _WIDTHS[0] <= width <= _WIDTHS[1]:  # A point is refused later.
        return
    guess = "check its unit (--unit) and its columns (--columns)"
    for name, (unit, factor) in _GUESSES.items():
        if 0.03 <= width * factor <= _WIDTHS[1]:
            guess = f"{name}? Give --unit {unit}"
            break
    raise DemonstrationError(f"the path is {width:.3g} m wide: {guess}.")


def fit_placement(
    demonstration: Demonstration, *, usable: ArrayLike, **rhythm: float | None
) -> Placement:
    """Fit the placement of a recorded path in the middle of a board.

    Only the bouts of the movement count: what is not learned, such as an approach from
    afar, neither moves nor scales it. The plane near which the tool stays longest becomes
    the surface; the path leaves it upwards, and so does the rest of the recording. The
    board's x axis is that of `front_axis`. The middle of the path's bounding box becomes
    the middle of the board, and a path that is too large is scaled down to the usable size.

    Parameters
    ----------
    demonstration : Demonstration
        With 3 position channels, m, in any frame.
    usable : array_like, shape (2,)
        Greatest extent of the path along the board's x and y, m.
    **rhythm : float, optional
        start_time, end_time and period, as for `find_rhythm`.

    Raises
    ------
    DemonstrationError
        Where the samples have no 3 channels, or all lie on a line.
    """
    channels = demonstration.values.shape[1]
    if channels != 3:
        raise DemonstrationError(
            f"the demonstration has {channels} channels; a path to lay onto a "
            "board needs 3 (x, y, z)."
        )
    return _fit(demonstration.values, samples_in_bouts(demonstration, **rhythm), usable)


def common_placement(
    demonstrations: Sequence[Demonstration],
    *,
    scenario: Scenario,
    **rhythm: float | None,
) -> Placement | None:
    """Return one placement for recordings of one movement in one frame.

    It is fitted to the samples of all recordings together. A board that was moved between
    them shows in paths that are together more than 10 % wider than the widest one, or in
    much less contact with the common plane than with the separate planes.

    Parameters
    ----------
    demonstrations : sequence of Demonstration
        With positions or joints; those of the board's frame and those without a
        position are ignored.
    scenario : Scenario
    **rhythm : float, optional
        As for `fit_placement`.

    Returns
    -------
    Placement or None
        None where there are fewer than two recordings, where they do not share frame
        and movement, where the board was moved, or where one cannot be placed.
    """
    usable, paths = _usable(scenario), list[Demonstration]()
    try:
        for demonstration in demonstrations:
            path, _ = _position(demonstration, scenario, needs_board=False)
            if path.channels == POSITION_CHANNELS and path.frame != "board":
                _check_lengths(path, **rhythm)
                paths.append(path)
        if len(paths) < 2 or len({path.frame for path in paths}) > 1:
            return None
        values = [path.values for path in paths]
        in_bouts = [samples_in_bouts(path, **rhythm) for path in paths]
        common = _fit(np.concatenate(values), np.concatenate(in_bouts), usable)
        separate = [_fit(*each, usable) for each in zip(values, in_bouts, strict=True)]
    except DemonstrationError:
        return None  # Placed alone, the recording is refused with its name.
    learned = [v[mask] for v, mask in zip(values, in_bouts, strict=True)]
    *widths, union = (
        np.linalg.norm(np.ptp(points, axis=0))
        for points in (*learned, np.concatenate(learned))
    )
    own = np.array([placement.touching for placement in separate])
    height = common.translation[2] / common.scale
    near = [np.abs(v @ common.rotation[2] + height) <= _TOUCH for v in learned]
    is_common = (
        union <= _WIDER * max(widths)
        and common.touching >= max(_AS_LONG * own.mean(), _LEAST_TOUCHING)
        and np.all([np.mean(each) for each in near] >= _EACH * own)
    )
    return common if is_common else None


def _usable(scenario: Scenario) -> Array:
    """Return the greatest extent of a path along a board's x and y, shape (2,), m."""
    usable: Array = np.array(scenario.board.size) - scenario.board_footprint() - BORDER
    return usable


def _fit(whole: Array, in_bouts: Mask, usable: ArrayLike) -> Placement:
    """Fit a placement to the samples (N, 3) of a path, m, and to those in bouts."""
    points = whole[in_bouts]
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * max(spread[0], 1e-12):
        raise DemonstrationError(
            "the demonstration stays on a point or a line, so its plane is not "
            "determined; give the transform to the board instead."
        )
    centre, normal = _longest_plane(points)
    heights = (whole - centre) @ normal
    # Approach and retreat tell the side, or else all samples off the plane.
    away = np.abs(heights) > max(_TOUCH, np.abs(heights[in_bouts]).max())
    heights = heights[away] if away.sum() >= _LEAST_AWAY else heights
    if np.sum(heights < -_TOUCH) > np.sum(heights > _TOUCH):
        normal = -normal
    x = front_axis(normal)
    rotation = np.stack([x, np.cross(normal, x), normal])
    flat = (points - centre) @ rotation.T
    low, high = flat[:, :2].min(axis=0), flat[:, :2].max(axis=0)
    extent = np.maximum(high - low, 1e-9)
    scale = float(min(1.0, np.min(np.asarray(usable, dtype=float) / extent)))
    middle = np.array([*(low + high) / 2, 0.0])
    return Placement(
        rotation=rotation,
        translation=-scale * (rotation @ centre + middle),
        scale=scale,
        touch=scale * _TOUCH,
        touching=float(np.mean(flat[:, 2] <= _TOUCH)),
    )


def _longest_plane(points: Array) -> tuple[Array, Array]:
    """Return a point of the plane that most samples touch, and its normal.

    Planes through three samples are tried (RANSAC, from a fixed seed); samples
    beyond the plane count against it. The best is fitted to the samples on it.
    """
    points = points[:: len(points) // _SAMPLES + 1]
    rng = np.random.default_rng(0)
    triples = points[rng.integers(len(points), size=(_TRIES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    keep = lengths > 1e-3 * np.max(lengths)
    normals = normals[keep] / lengths[keep, None]
    normals = np.concatenate([normals, -normals])
    origins = np.concatenate([triples[keep, 0]] * 2)
    heights = points @ normals.T - np.einsum("ij,ij->i", origins, normals)
    score = np.sum(np.abs(heights) <= _TOUCH, axis=0) - np.sum(
        heights < -_TOUCH, axis=0
    )
    # Of equally good planes, the one whose normal points up.
    best = int(np.argmax(score + 1e-3 * normals[:, 2]))
    contact = points[np.abs(heights[:, best]) <= _TOUCH]
    centre = contact.mean(axis=0)
    # The direction of least scatter; a full SVD would build an N x N array.
    normal = np.linalg.eigh((contact - centre).T @ (contact - centre))[1][:, 0]
    return centre, normal * np.sign(normal @ normals[best])


def as_poses(
    demonstration: Demonstration,
    scenario: Scenario,
    remarks: list[str],
    **rhythm: float | None,
) -> Demonstration:
    """Return a recording of poses, by kinematics where it has joints alone; add remarks."""
    names = demonstration.channels
    if not set(POSITION_CHANNELS) <= set(names):
        path = _by_kinematics(demonstration, scenario, remarks, with_orientation=True)
        if path is None:
            raise DemonstrationError(_missing_position(demonstration, scenario.robot))
        demonstration = path
    _check_lengths(demonstration, **rhythm)
    return demonstration


def _by_kinematics(
    demonstration: Demonstration,
    scenario: Scenario,
    remarks: list[str],
    *,
    with_orientation: bool = False,
) -> Demonstration | None:
    """Return the eraser's path for recorded joints, and add a remark; None without joints."""
    robot = FindRobot(demonstration, robot=scenario.robot)
    if robot is None:
        return None
    joints = RobotJoints(demonstration, robot=robot)
    remarks.append(
        f"the eraser's path by the forward kinematics of {Path(robot).stem}, from "
        f"{', '.join(joints)}"
    )
    return EraserPath(
        demonstration,
        eraser=scenario.eraser,
        robot=robot,
        with_orientation=with_orientation,
    )


def _check_lengths(demonstration: Demonstration, **rhythm: float | None) -> None:
    """Refuse x, y and z in another unit than m, or of a width that no arm can follow."""
    units = set(demonstration.select(POSITION_CHANNELS).units)
    if units != {"m"}:
        raise DemonstrationError(
            f"x, y and z are in {' and '.join(sorted(units))}, which is not a known "
            "unit of length; convert them to metres."
        )
    part = (rhythm.get("start_time"), rhythm.get("end_time"))
    check_width(*cut_demonstrations([demonstration], *part, DEFAULT_RATE))


def _played_channels(demonstration: Demonstration, *, is_placed: bool) -> list[str]:
    """Return the channels that a robot plays.

    Orientation and force are among them where a demonstration is in the board's frame
    already. How a tool of another recording was held is not known.
    """
    names = list(POSITION_CHANNELS)
    if not (is_placed and demonstration.frame == "board"):
        return names
    units = dict(zip(demonstration.channels, demonstration.units, strict=True))
    if demonstration.rotation_reference is not None:
        names += ROTATION_CHANNELS
    if units.get(FORCE_CHANNEL) == "N":
        names.append(FORCE_CHANNEL)
    return names


def _missing_position(demonstration: Demonstration, robot: str) -> str:
    """Return why a recording without x, y and z is refused, and what to do."""
    for note in demonstration.note.split("; "):
        if note.startswith(SEVERAL):
            return f"{note}, or learn all of them as they are (learn --as-recorded)"
    return (
        f"the channels are {listed(demonstration.channels)}; the board needs x, y and z, "
        "or x and y of a drawing. "
        f"{_advice_without_position(demonstration, robot)}"
    )


def _advice_without_position(demonstration: Demonstration, robot: str) -> str:
    """Return what to do with a recording without x, y and z."""
    names, units, advice = demonstration.channels, demonstration.units, ""
    others = [r for r in ListRobots() if RobotJoints(demonstration, robot=r)]
    if others and "rad" in units:
        return f"Joints of {' or '.join(others)}? Name it: --robot {others[0]}"
    turns = {name for name, unit in zip(names, units, strict=True) if unit == "rad"}
    if turns - set(ROTATION_CHANNELS):
        advice = f"Joints of another robot than {robot}? Name it (learn --robot). "
    axes = POSITION_CHANNELS[: len(names)]
    if len(axes) < 2:
        return f"{advice}Learn it as it is: learn --as-recorded"
    lengths = [n for n, unit in zip(names, units, strict=True) if unit == "m"]
    others = [n for n, unit in zip(names, units, strict=True) if unit in ("m", "1")]
    are_lengths = len(lengths) >= len(axes)
    sources = lengths if are_lengths else ["COLUMN"] * len(axes)
    candidates = lengths if are_lengths else others
    named = [
        name
        for axis in axes
        for name in [n for n in candidates if _is_axis(n, axis)][:1]
    ]
    if len(named) == len(axes):
        sources = named
    example = columns_option(dict(zip(axes, sources, strict=False)))
    return (
        f"{advice}Learn it as it is (learn --as-recorded), or, if they are among the "
        f"channels, name them, such as {example}"
    )


def _is_axis(name: str, axis: str) -> bool:
    """Return whether a name may be that of a position along an axis: `tx_world`."""
    words = re.split(r"[\W_]+", name.lower())
    return bool({axis, f"t{axis}"} & {*words}) and not NO_POSITION.search(name.lower())


def _position(
    demonstration: Demonstration,
    scenario: Scenario,
    *,
    needs_board: bool,
    keeps_pose: bool = True,
) -> tuple[Demonstration, list[str]]:
    """Return the channels of a recording that are played on a board, and remarks.

    A recording without a position is unchanged where no board is needed.
    """
    remarks = list[str]()
    names = demonstration.channels
    if not set(POSITION_CHANNELS) <= set(names):
        if path := _by_kinematics(demonstration, scenario, remarks):
            demonstration = path
        elif {"x", "y"} <= set(names):
            flat = demonstration.select(POSITION_CHANNELS[:2])
            demonstration = replace(
                flat,
                values=np.pad(flat.values, ((0, 0), (0, 1))),
                channels=POSITION_CHANNELS,
                units=(*flat.units, flat.units[0]),
            )
            remarks.append("x and y without z: taken as a drawing on the board")
            if others := [name for name in names if name not in flat.channels]:
                remarks.append(f"{listed(others)} left out: a drawing needs x and y")
        elif needs_board or f"; {SEVERAL} " in f"; {demonstration.note}":
            raise DemonstrationError(_missing_position(demonstration, scenario.robot))
        else:
            return demonstration, ["as recorded: without x, y and z there is no board"]
    else:
        played = _played_channels(demonstration, is_placed=keeps_pose)
        recorded, demonstration = demonstration, demonstration.select(played)
        if others := [name for name in names if name not in played]:
            needed = f"{', '.join(played[:-1])} and {played[-1]}"
            options = extra_options(recorded)
            learns = f" (--surface fitted {options} learns more)" if options else ""
            remarks.append(
                f"{listed(others)} left out: the board needs {needed}{learns}"
            )
    return demonstration, remarks


def place_on_board(
    demonstration: Demonstration,
    *,
    scenario: Scenario,
    transform: Sequence[float] | None = None,
    needs_board: bool = True,
    placement: Placement | None = None,
    **rhythm: float | None,
) -> tuple[Demonstration, list[str]]:
    """Return a demonstration in the frame of the board, and remarks.

    It has x, y and z, and orientation and force where it was in that frame already.
    `placement` is one that it shares with others; where None, its own is fitted.
    `rhythm` is that of `fit_placement`.

    Raises
    ------
    DemonstrationError
        Where there is no position, or the path does not fit the board.
    """
    demonstration, remarks = _position(
        demonstration, scenario, needs_board=needs_board, keeps_pose=transform is None
    )
    if not set(POSITION_CHANNELS) <= set(demonstration.channels):
        return demonstration, remarks
    _check_lengths(demonstration, **rhythm)
    if transform is not None:
        pose = finite_array(transform, "the transform", (6,), error=DemonstrationError)
        placement = Placement(
            rotation=Rotation.from_euler("xyz", pose[3:]).as_matrix(),
            translation=pose[:3],
        )
        return placement.apply(demonstration), remarks
    if demonstration.frame == "board":
        return demonstration, remarks
    is_common = placement is not None
    if placement is None:
        usable = _usable(scenario)
        placement = fit_placement(demonstration, usable=usable, **rhythm)
    touching = f"{100 * placement.touching:.0f} % of the time"
    instead = "give its pose (--transform), or learn it as it is (learn --as-recorded)."
    if placement.touching < _LEAST_TOUCHING:
        raise DemonstrationError(
            f"placed on the board, the tool would touch it only {touching}; at least "
            f"{100 * _LEAST_TOUCHING:.0f} % is needed; {instead}"
        )
    check_scale(placement.scale, f"Or {instead}")
    tilt = np.degrees(np.arccos(min(abs(placement.rotation[2, 2]), 1.0)))
    tilted = f" (tilted by {tilt:.0f} degrees in the recording)" if tilt > _TILT else ""
    plane = "the common plane of all recordings" if is_common else "its plane"
    remarks.append(
        f"placed in the middle of the board by {plane}{tilted}, at "
        f"{100 * placement.scale:.0f} % of its size; it touches the board {touching}"
    )
    return placement.apply(demonstration), remarks
