"""Set-point for a point of the arm, from a drag of the mouse on the page.

The page is not trusted: it may be slow, stop, or send any number. Its messages move a
set-point with limits on speed, step per message, and travel without a new message. The
drag ends where messages stop or the cursor jumps.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.numeric import Array
from fmp_drake.settings import bounded
from fmp_drake.systems.surface import surface as surfaces
from fmp_drake.systems.surface.surface import Surface

# Smallest cosine between a ray and the normal of the plane that it intersects.
_MIN_COSINE = 0.08
# A page sends no new message while the body moves less than this, m.
_MOTION_THRESHOLD = 0.005
# Largest difference of equal messages, m.
_TOLERANCE = 1e-9
# Height over the board, m, up to which the spring pulls the tool back to it.
_LIFT = 0.006
# Shortest lever with which the tool is turned, m, and largest rotation without a new
# message, rad.
_LEVER, _MAX_ROTATION = 0.10, 0.3


@dataclass(frozen=True, kw_only=True)
class DragConfig:
    """Spring between the mouse and the arm, and limits of its set-point.

    Attributes
    ----------
    stiffness, damping : float
        Of the spring to the set-point, N/m and Ns/m.
    max_force : float
        N; in the plane of the board, where there is one.
    normal_force : float
        On the board, N.
    holds : bool
        Whether the arm is held where the drag ends, or released.
    max_speed : float
        Of the set-point, m/s.
    max_jump : float
        Of the cursor from one message to the next, m; a larger jump ends the drag.
    max_travel : float
        Travel of the set-point without a new message, m.
    timeout : float
        Time without a new message, although the arm moves, after which the drag ends,
        s.
    max_angular_speed : float
        Of the set-point of the orientation, rad/s.
    max_rotation : float
        Largest rotation of the tool from its orientation at rest, rad.

    Examples
    --------
    >>> PULLING_DRAG.max_force
    40.0
    """

    stiffness: float = bounded(400.0, above=0)
    damping: float = bounded(40.0, least=0)
    max_force: float = bounded(40.0, above=0)
    normal_force: float = bounded(0.0, least=0)
    holds: bool = False
    max_speed: float = bounded(0.8, above=0)
    max_jump: float = bounded(0.2, above=0)
    max_travel: float = bounded(0.08, above=0)
    timeout: float = bounded(0.3, above=0)
    max_angular_speed: float = bounded(1.2, above=0)
    max_rotation: float = bounded(0.6, above=0)


GUIDING_DRAG = DragConfig(
    stiffness=2500.0, damping=250.0, max_force=60.0, normal_force=5.0, holds=True
)
"""Hand guiding of an arm that is free to move; it is held where the drag ends."""

PULLING_DRAG = DragConfig(max_jump=0.6)
"""A disturbance of an arm at work."""


class Drag(NamedTuple):
    """Message of the page: a body, and the ends of its spring.

    Attributes
    ----------
    body : int
    point : ndarray, shape (3,)
        p_BoQ_B of the dragged point in the page's last picture, m.
    anchor, cursor : ndarray, shape (3,)
        In W: the same point, and the cursor in the plane of the screen, m.
    """

    body: int
    point: Array
    anchor: Array
    cursor: Array


class BoardSurface(NamedTuple):
    """The board along which the tool is guided; the tool stays within its edges.

    In free space it is a plane, and the tool is guided parallel to it.

    Attributes
    ----------
    X_WB : ndarray, shape (3, 4)
    half_size : ndarray, shape (2,)
        Half of the edges of the area for the tool along x and y of B, or along a curved
        board, m.
    curvature : Surface
    is_solid : bool
        Whether the tool is pressed on it; False in free space.

    Examples
    --------
    >>> board = BoardSurface(np.eye(3, 4), np.array([0.2, 0.3]))
    >>> board.clamped(np.array([0.5, 0.0, 0.1]))
    array([0.2, 0. , 0.1])
    """

    X_WB: Array
    half_size: Array
    curvature: Surface = Surface()
    is_solid: bool = True

    def coordinates(self, p_W: Array) -> Array:
        """Return (u, v, h) of a point, m."""
        p_B = self.X_WB[:, :3].T @ (p_W - self.X_WB[:, 3])
        return surfaces.project(self.curvature, p_B, np.zeros(2))

    def height(self, p_W: Array) -> float:
        """Return the height of a point over the board, m."""
        return float(self.coordinates(p_W)[2])

    def normal(self, p_W: Array) -> Array:
        """Return the normal out of the board next to a point, in W."""
        u, v, _ = self.coordinates(p_W)
        return self.X_WB[:, :3] @ surfaces.rotation(self.curvature, u, v)[:, 2]

    def clamped(self, p_W: Array) -> Array:
        """Return the nearest point over the area for the tool."""
        uvh = self.coordinates(p_W)
        uvh[:2] = np.clip(uvh[:2], -self.half_size, self.half_size)
        p_B = surfaces.place(self.curvature, uvh[None])[0]
        return self.X_WB[:, 3] + self.X_WB[:, :3] @ p_B

    def ray_intersection(
        self, cursor: Array, *, eye: Array, point: Array
    ) -> Array | None:
        """Intersect the ray from the eye through the cursor with the height of a point.

        Where the ray misses a curved board, the result is its point nearest to the board.

        Parameters
        ----------
        cursor, eye, point : ndarray, shape (3,)
            In W, m.

        Returns
        -------
        ndarray, shape (3,), or None
            None where the ray grazes a flat board, or meets the board behind the eye.
        """
        if self.curvature.is_plane:
            normal = self.X_WB[:, 2]
            return ray_intersection(cursor, eye=eye, point=point, normal=normal)
        kx, ky = self.curvature
        k = float(kx if kx != 0 else ky)
        R = self.X_WB[:, :3]
        directions = np.array([kx != 0, ky != 0, True])
        ray = directions * (R.T @ (cursor - eye))
        from_centre = directions * (R.T @ (eye - self.X_WB[:, 3]) + [0.0, 0.0, 1 / k])
        radius = 1 / k + self.height(point)
        a, b = float(ray @ ray), float(ray @ from_centre)
        beyond = float(from_centre @ from_centre) - radius**2
        root = np.sqrt(max(b**2 - a * beyond, 0.0))
        distance = -b - np.copysign(root, k)
        return eye + (cursor - eye) * distance / a if distance > 0 else None


# All fields are numbers of 8 bytes, so that one array of floats holds them.
STATE = np.dtype(
    [
        ("started", "f8"),
        ("guiding", "f8"),
        ("ended", "f8"),  # By a jump: the button must be released first.
        ("body", "f8"),
        ("point", "3f8"),  # p_BoQ_B of the dragged point.
        ("message", "6f8"),  # Anchor and cursor.
        ("message_time", "f8"),
        ("message_point", "3f8"),  # Moved point at that time; in W, as all below.
        ("cursor_time", "f8"),
        ("interval", "f8"),  # Between two cursors.
        ("eye", "3f8"),
        ("grabbed", "3f8"),
        ("offset", "3f8"),  # From the dragged to the guided point.
        ("aim", "3f8"),
        ("goal", "3f8"),  # The aim, over the board.
        ("set_point", "3f8"),
        ("speed", "f8"),
        ("travel", "f8"),  # Remaining travel without a new message.
        ("turning", "f8"),  # The drag turns the tool, and does not move its end.
        # Rotation vectors of the tool from its orientation at rest: set-point, at the
        # start of the drag, and goal; rad.
        ("rotation", "3f8"),
        ("grabbed_rotation", "3f8"),
        ("rotation_goal", "3f8"),
    ]
)
"""State of a drag as a structured type; see `follow`."""

STARTED, GUIDING = (
    list(STATE.names or ()).index(name) for name in ("started", "guiding")
)
"""Indices of these numbers in the state."""

_MESSAGE = STATE.fields["message"][1] // 8  # type: ignore[index]


def is_idle(state: Array) -> bool:
    """Return whether `follow` without a drag would leave a state (n,) as it is."""
    # A drag that has ended also has a message.
    return bool(state[STARTED] and not state[GUIDING] and math.isnan(state[_MESSAGE]))


def no_drag() -> Array:
    """Return the initial state, shape (n,)."""
    state = np.zeros(1, STATE)
    state["message"] = np.nan
    state["interval"] = 1 / 60
    return state.view(np.float64)


def cursor_of(
    force: Array, *, anchor: Array, velocity: Array, mass: float, stiffness: float
) -> Array:
    """Return the position of the cursor, from the force of Drake's mouse spring.

    The force is ``m (k d - sqrt(k) v)``; Drake does not report d itself.

    Parameters
    ----------
    force : ndarray, shape (3,)
        In W, N.
    anchor, velocity : ndarray, shape (3,)
        Of the dragged point, in W, m and m/s.
    mass : float
        Of the body, kg.
    stiffness : float
        Of the spring for each kilogram, 1/s^2.
    """
    return anchor + force / (mass * stiffness) + velocity / np.sqrt(stiffness)


def ray_intersection(
    cursor: Array, *, eye: Array, point: Array, normal: Array
) -> Array | None:
    """Return the intersection of a plane with the ray from the eye through the cursor.

    Parameters
    ----------
    cursor, eye : ndarray, shape (3,)
        In W, m.
    point, normal : ndarray, shape (3,)
        Of the plane; the normal has length 1.

    Returns
    -------
    ndarray, shape (3,), or None
        None where the ray grazes the plane, or meets it behind the eye.
    """
    ray = cursor - eye
    slope, height = float(ray @ normal), float((point - eye) @ normal)
    if abs(slope) < _MIN_COSINE * float(np.linalg.norm(ray)) or height / slope <= 0:
        return None
    return eye + ray * (height / slope)


def follow(
    state: Array,
    drag: Drag | None,
    *,
    time: float,
    period: float,
    guided_point: Array,
    eye: Array,
    config: DragConfig,
    board: BoardSurface | None,
    rotation: Array | None = None,
    turns_tool: bool = False,
) -> Array:
    """Return the state after reading the page.

    Parameters
    ----------
    state : ndarray, shape (n,)
    drag : Drag or None
        None where nothing is dragged.
    time, period : float
        Of the reading, and between two readings, s.
    guided_point : ndarray, shape (3,)
        In W, m.
    eye : ndarray, shape (3,)
        Of the page's camera, in W, m.
    config : DragConfig
    board : BoardSurface, optional
        None to follow the cursor in the plane of the screen.
    rotation : ndarray, shape (3,), optional
        Measured rotation vector of the tool from its orientation at rest, in W, rad.
    turns_tool : bool
        Whether a drag that begins now turns the tool around its end.
    """
    floats = state.copy()
    s = floats.view(STATE)[0]
    if not s["started"]:
        # A message from before the start is outdated: wait for a new one.
        s["started"], s["set_point"] = 1, guided_point
        s["ended"], s["rotation"] = 0, 0.0 if rotation is None else rotation
        s["message"] = np.nan if drag is None else np.r_[drag.anchor, drag.cursor]
        return floats
    if drag is None:
        _release(s, guided_point)
        s["ended"], s["message"] = 0, np.nan
        return floats
    message = np.r_[drag.anchor, drag.cursor]
    is_new = not np.all(np.abs(message - s["message"]) < _TOLERANCE)
    moved_cursor = not np.all(np.abs(message[3:] - s["message"][3:]) < _TOLERANCE)
    if s["guiding"] and s["body"] != drag.body:
        _release(s, guided_point)
    if s["ended"] or not (is_new or s["guiding"]):
        return floats
    if is_new:
        is_grabbed = not s["guiding"]
        if is_grabbed:
            s["guiding"], s["body"], s["point"] = 1, drag.body, drag.point
            s["eye"], s["grabbed"] = eye, drag.anchor
            s["offset"] = guided_point - drag.anchor
            s["aim"] = s["set_point"] = guided_point
            s["cursor_time"], s["turning"] = time, turns_tool
            s["grabbed_rotation"] = s["rotation_goal"] = s["rotation"]
            if turns_tool:
                s["aim"] = drag.anchor
        s["message"], s["message_time"] = message, time
        s["message_point"] = _moved_point(s, guided_point)
        s["travel"] = _MAX_ROTATION if s["turning"] else config.max_travel
        if is_grabbed or moved_cursor:
            _set_goal(s, drag.cursor, time, period, config, board)
            if s["ended"]:
                _release(s, guided_point)
                return floats
    elif time - s["message_time"] > config.timeout:
        motion = _moved_point(s, guided_point) - s["message_point"]
        if np.linalg.norm(motion) > _MOTION_THRESHOLD:
            _release(s, guided_point)
            return floats
    name, goal, _ = _moved_quantity(s, config)
    displacement = s[goal] - s[name]
    distance = float(np.linalg.norm(displacement))
    step = min(s["speed"] * period, s["travel"], distance)
    if step > 0:
        s[name] += step / distance * displacement
        s["travel"] -= step
    return floats


def _moved_point(s: Any, guided_point: Array) -> Array:
    """Return the point that a drag moves, m: the guided point, or the end of a lever."""
    return s["rotation"] * _LEVER if s["turning"] else guided_point


def _moved_quantity(s: Any, config: DragConfig) -> tuple[str, str, float]:
    """Return the names of what a drag moves and of its goal, and its largest speed."""
    if s["turning"]:
        return "rotation", "rotation_goal", config.max_angular_speed
    return "set_point", "goal", config.max_speed


def _set_goal(
    s: Any,
    cursor: Array,
    time: float,
    period: float,
    config: DragConfig,
    board: BoardSurface | None,
) -> None:
    """Set the goal to a new cursor, to be reached when the next one comes.

    A drag that turns the tool rotates it around the guided point: the grabbed point
    follows the cursor in the plane across the lever between them.
    """
    aim: Array | None = cursor
    lever, offset = -s["offset"], s["offset"]
    length = float(np.linalg.norm(lever))
    if s["turning"]:
        if length < _LEVER:
            up = np.array([0.0, 0.0, 1.0]) if board is None else board.X_WB[:, 2]
            lever, length = _LEVER * up, _LEVER
        offset = np.zeros(3)
        aim = ray_intersection(
            cursor, eye=s["eye"], point=s["grabbed"], normal=lever / length
        )
    elif board is not None:
        aim = board.ray_intersection(cursor, eye=s["eye"], point=s["grabbed"])
    if aim is None or np.linalg.norm(aim + offset - s["aim"]) > config.max_jump:
        s["ended"] = 1
        return
    s["aim"] = aim + offset
    if s["turning"]:
        turn = Rotation.from_rotvec(np.cross(lever, aim - s["grabbed"]) / length**2)
        phi = (turn * Rotation.from_rotvec(s["grabbed_rotation"])).as_rotvec()
        fraction = min(1.0, config.max_rotation / max(np.linalg.norm(phi), 1e-9))
        s["rotation_goal"] = phi * fraction
    else:
        s["goal"] = s["aim"] if board is None else board.clamped(s["aim"])
    if 0 < (elapsed := time - s["cursor_time"]) <= config.timeout:
        s["interval"] = (s["interval"] + elapsed) / 2
    s["cursor_time"] = time
    name, goal, max_speed = _moved_quantity(s, config)
    distance = float(np.linalg.norm(s[goal] - s[name]))
    s["speed"] = min(max_speed, distance / max(s["interval"], period))


def _release(s: Any, guided_point: Array) -> None:
    """End the guiding; the arm is held at the guided point."""
    if s["guiding"]:
        s["guiding"], s["set_point"] = 0, guided_point


def hand_force(
    displacement: Array,
    velocity: Array,
    *,
    config: DragConfig,
    normal: Array | None = None,
    height: float = 0.0,
) -> Array:
    """Return the force of the hand on the guided or held point, in W, N.

    Parameters
    ----------
    displacement : ndarray, shape (3,)
        From the point to its set-point, in W, m.
    velocity : ndarray, shape (3,)
        Of the point, in W, m/s.
    config : DragConfig
    normal : ndarray, shape (3,), or None
        Out of the board, in W: the spring acts in its plane; along it the normal force
        and damping act. None for a spring in all directions.
    height : float
        Of the point over the board, m; it adds to the normal force.
    """
    f = config.stiffness * displacement - config.damping * velocity
    f_normal = np.zeros(3)
    if normal is not None:
        f -= normal * (normal @ f)
        pressing = config.normal_force + config.damping * float(normal @ velocity)
        pressing += config.stiffness * float(np.clip(height, 0.0, _LIFT))
        f_normal = -normal * np.clip(pressing, -config.max_force, config.max_force)
    strength = float(np.linalg.norm(f))
    return f * min(1.0, config.max_force / max(strength, 1e-12)) + f_normal
