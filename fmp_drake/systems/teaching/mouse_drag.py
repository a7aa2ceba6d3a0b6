"""Set-point for a point of the arm, from a drag of the mouse on the page.

The page is not trusted: it may be slow, stop, or send any number. Its messages move a
set-point with limits on speed, step per message, and travel without a new message. The
drag ends where messages stop or the cursor jumps.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fmp_drake.systems.surface import surface as surfaces
from fmp_drake.systems.surface.surface import Surface

Array = NDArray[np.float64]

# Smallest cosine between a ray and the normal of the plane that it intersects.
_GRAZING = 0.08
# A page sends no new message while the body moves less than this, m.
_MOTION_THRESHOLD = 0.005
_SAME = 1e-9
# Height over the board, m, up to which the spring pulls the tool back to it.
_LIFT = 0.006
# Shortest lever with which the tool is turned, m, and rotation without a new message, rad.
_LEVER, _TURN_AHEAD = 0.10, 0.3


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
    max_ahead : float
        Travel of the set-point without a new message, m.
    patience : float
        Time without a new message, although the arm moves, after which the drag ends,
        s.
    max_turn_rate : float
        Of the set-point of the orientation, rad/s.
    max_lean : float
        Greatest rotation of the tool from the way it is held at rest, rad.

    Examples
    --------
    >>> PULLING_DRAG.max_force
    40.0
    """

    stiffness: float
    damping: float
    max_force: float
    normal_force: float = 0.0
    holds: bool = False
    max_speed: float = 0.8
    max_jump: float = 0.2
    max_ahead: float = 0.08
    patience: float = 0.3
    max_turn_rate: float = 1.2
    max_lean: float = 0.6


GUIDING_DRAG = DragConfig(
    stiffness=2500.0, damping=250.0, max_force=60.0, normal_force=5.0, holds=True
)
"""Hand guiding of an arm that is free to move; it is held where the drag ends."""

PULLING_DRAG = DragConfig(stiffness=400.0, damping=40.0, max_force=40.0, max_jump=0.6)
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
    """The board, along which the tool is guided; it does not leave its edges.

    In free space it is a plane, and the tool is guided parallel to it.

    Attributes
    ----------
    X_WB : ndarray, shape (3, 4)
    half_size : ndarray, shape (2,)
        Half edges of the area for the tool along x and y of B, on a curved board along it, m.
    curvature : Surface
    is_solid : bool
        Whether the tool is pressed on it; False in free space.

    Examples
    --------
    >>> board = BoardSurface(np.eye(3, 4), np.array([0.2, 0.3]))
    >>> board.inside(np.array([0.5, 0.0, 0.1]))
    array([0.2, 0. , 0.1])
    """

    X_WB: Array
    half_size: Array
    curvature: Surface = Surface()
    is_solid: bool = True

    def coordinates(self, p_W: Array) -> Array:
        """Return (u, v, h) of a point, m."""
        p_B = self.X_WB[:, :3].T @ (p_W - self.X_WB[:, 3])
        uvh: Array = surfaces.project(self.curvature, p_B, np.zeros(2))
        return uvh

    def height(self, p_W: Array) -> float:
        """Return the height of a point over the board, m."""
        return float(self.coordinates(p_W)[2])

    def normal(self, p_W: Array) -> Array:
        """Return the normal out of the board next to a point, in W."""
        u, v, _ = self.coordinates(p_W)
        normal: Array = self.X_WB[:, :3] @ surfaces.rotation(self.curvature, u, v)[:, 2]
        return normal

    def inside(self, p_W: Array) -> Array:
        """Return the nearest point over the area for the tool."""
        uvh = self.coordinates(p_W)
        uvh[:2] = np.clip(uvh[:2], -self.half_size, self.half_size)
        p_B = surfaces.place(self.curvature, uvh[None])[0]
        inside: Array = self.X_WB[:, 3] + self.X_WB[:, :3] @ p_B
        return inside

    def slide(self, cursor: Array, *, eye: Array, point: Array) -> Array | None:
        """Return where the ray from the eye through the cursor is as high as a point.

        A ray past a curved board is at its nearest point to it.

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
            return slide(cursor, eye=eye, point=point, normal=self.X_WB[:, 2])
        kx, ky = self.curvature
        k = float(kx if kx != 0 else ky)
        R = self.X_WB[:, :3]
        across = np.array([kx != 0, ky != 0, True])
        ray = across * (R.T @ (cursor - eye))
        from_centre = across * (R.T @ (eye - self.X_WB[:, 3]) + [0.0, 0.0, 1 / k])
        radius = 1 / k + self.height(point)
        a, b = float(ray @ ray), float(ray @ from_centre)
        beyond = float(from_centre @ from_centre) - radius**2
        root = np.sqrt(max(b**2 - a * beyond, 0.0))
        way = -b - np.copysign(root, k)
        return eye + (cursor - eye) * way / a if way > 0 else None


# Numbers of 8 bytes only: one array of floats holds them.
STATE = np.dtype(
    [
        ("started", "f8"),
        ("guiding", "f8"),
        ("lost", "f8"),  # Ended by a jump: the button must be released first.
        ("body", "f8"),
        ("point", "3f8"),  # p_BoQ_B of the dragged point.
        ("message", "6f8"),  # Anchor and cursor.
        ("message_time", "f8"),
        ("here", "3f8"),  # Guided point at that time; in W, as all below.
        ("cursor_time", "f8"),
        ("interval", "f8"),  # Between two cursors.
        ("eye", "3f8"),
        ("grabbed", "3f8"),
        ("offset", "3f8"),  # From the dragged to the guided point.
        ("aim", "3f8"),
        ("goal", "3f8"),  # The aim, over the board.
        ("wanted", "3f8"),
        ("speed", "f8"),
        ("left", "f8"),  # Travel that is left without a new message.
        ("turning", "f8"),  # The drag turns the tool, and does not move its end.
        # Rotation vectors from the way the tool is held at rest: now, when it was
        # grabbed, and the goal; rad.
        ("lean", "3f8"),
        ("grabbed_lean", "3f8"),
        ("lean_goal", "3f8"),
    ]
)
"""State of a drag as a structured type; see `follow`."""


def no_drag() -> Array:
    """Return the initial state, shape (n,)."""
    state = np.zeros(1, STATE)
    state["message"] = np.nan
    state["interval"] = 1 / 60
    floats: Array = state.view(np.float64)
    return floats


def cursor_of(
    force: Array, *, anchor: Array, velocity: Array, mass: float, stiffness: float
) -> Array:
    """Return the position of the cursor, from the force of Drake's mouse spring.

    The force is ``m (k d - sqrt(k) v)``; Drake reports no other sign of d.

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


def slide(cursor: Array, *, eye: Array, point: Array, normal: Array) -> Array | None:
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
    across, way = float(ray @ normal), float((point - eye) @ normal)
    if abs(across) < _GRAZING * float(np.linalg.norm(ray)) or way / across <= 0:
        return None
    return eye + ray * (way / across)


def follow(
    state: Array,
    drag: Drag | None,
    *,
    time: float,
    period: float,
    here: Array,
    eye: Array,
    config: DragConfig,
    board: BoardSurface | None,
    lean: Array | None = None,
    turns: bool = False,
) -> Array:
    """Return the state after reading the page.

    Parameters
    ----------
    state : ndarray, shape (n,)
    drag : Drag or None
        None where nothing is dragged.
    time, period : float
        Of the reading, and between two readings, s.
    here : ndarray, shape (3,)
        The guided point, in W, m.
    eye : ndarray, shape (3,)
        Of the page's camera, in W, m.
    config : DragConfig
    board : BoardSurface, optional
        None to follow the cursor in the plane of the screen.
    lean : ndarray, shape (3,), optional
        Measured rotation vector of the tool from the way it is held at rest, in W, rad.
    turns : bool
        Whether a drag that begins now turns the tool around its end.
    """
    floats = state.copy()
    s = floats.view(STATE)[0]
    if not s["started"]:
        # A message from before the start is old: wait for a new one.
        s["started"], s["wanted"] = 1, here
        s["lost"], s["lean"] = 0, 0.0 if lean is None else lean
        s["message"] = np.nan if drag is None else np.r_[drag.anchor, drag.cursor]
        return floats
    if drag is None:
        _let_go(s, here)
        s["lost"], s["message"] = 0, np.nan
        return floats
    message = np.r_[drag.anchor, drag.cursor]
    is_new = not np.all(np.abs(message - s["message"]) < _SAME)
    moved_cursor = not np.all(np.abs(message[3:] - s["message"][3:]) < _SAME)
    if s["guiding"] and s["body"] != drag.body:
        _let_go(s, here)
    if s["lost"] or not (is_new or s["guiding"]):
        return floats
    if is_new:
        grabs = not s["guiding"]
        if grabs:
            s["guiding"], s["body"], s["point"] = 1, drag.body, drag.point
            s["eye"], s["grabbed"], s["offset"] = eye, drag.anchor, here - drag.anchor
            s["aim"] = s["wanted"] = here
            s["cursor_time"], s["turning"] = time, turns
            s["grabbed_lean"] = s["lean_goal"] = s["lean"]
            if turns:
                s["aim"] = drag.anchor
        s["message"], s["message_time"], s["here"] = message, time, _place(s, here)
        s["left"] = _TURN_AHEAD if s["turning"] else config.max_ahead
        if grabs or moved_cursor:
            aim = _aim_lean if s["turning"] else _aim
            aim(s, drag.cursor, time, period, config, board)
            if s["lost"]:
                _let_go(s, here)
                return floats
    elif (
        time - s["message_time"] > config.patience
        and np.linalg.norm(_place(s, here) - s["here"]) > _MOTION_THRESHOLD
    ):
        _let_go(s, here)
        return floats
    now, goal = ("lean", "lean_goal") if s["turning"] else ("wanted", "goal")
    way = s[goal] - s[now]
    distance = float(np.linalg.norm(way))
    step = min(s["speed"] * period, s["left"], distance)
    if step > 0:
        s[now] += step / distance * way
        s["left"] -= step
    return floats


def _place(s: Any, here: Array) -> Array:
    """Return the point that a drag moves, m: the guided point, or the end of a lever."""
    return s["lean"] * _LEVER if s["turning"] else here


def _aim(
    s: Any,
    cursor: Array,
    time: float,
    period: float,
    config: DragConfig,
    board: BoardSurface | None,
) -> None:
    """Set the goal to a new cursor, to be reached when the next one comes."""
    aim: Array | None = cursor
    if board is not None:
        aim = board.slide(cursor, eye=s["eye"], point=s["grabbed"])
    if aim is None or np.linalg.norm(aim + s["offset"] - s["aim"]) > config.max_jump:
        s["lost"] = 1
        return
    s["aim"] = aim + s["offset"]
    s["goal"] = s["aim"] if board is None else board.inside(s["aim"])
    _take_time(s, time, config)
    distance = float(np.linalg.norm(s["goal"] - s["wanted"]))
    s["speed"] = min(config.max_speed, distance / max(s["interval"], period))


def _aim_lean(
    s: Any,
    cursor: Array,
    time: float,
    period: float,
    config: DragConfig,
    board: BoardSurface | None,
) -> None:
    """Set the goal of the rotation: around the guided point the grabbed one follows."""
    lever = -s["offset"]
    length = float(np.linalg.norm(lever))
    if length < _LEVER:
        up = np.array([0.0, 0.0, 1.0]) if board is None else board.X_WB[:, 2]
        lever, length = _LEVER * up, _LEVER
    aim = slide(cursor, eye=s["eye"], point=s["grabbed"], normal=lever / length)
    if aim is None or np.linalg.norm(aim - s["aim"]) > config.max_jump:
        s["lost"] = 1
        return
    s["aim"] = aim
    turn = Rotation.from_rotvec(np.cross(lever, aim - s["grabbed"]) / length**2)
    goal = (turn * Rotation.from_rotvec(s["grabbed_lean"])).as_rotvec()
    s["lean_goal"] = goal * min(1.0, config.max_lean / max(np.linalg.norm(goal), 1e-9))
    _take_time(s, time, config)
    distance = float(np.linalg.norm(s["lean_goal"] - s["lean"]))
    s["speed"] = min(config.max_turn_rate, distance / max(s["interval"], period))


def _take_time(s: Any, time: float, config: DragConfig) -> None:
    """Take the time between two cursors from that of a new one."""
    if 0 < (since := time - s["cursor_time"]) <= config.patience:
        s["interval"] = (s["interval"] + since) / 2
    s["cursor_time"] = time


def _let_go(s: Any, here: Array) -> None:
    if s["guiding"]:
        s["guiding"], s["wanted"] = 0, here


def hand_force(
    away: Array,
    velocity: Array,
    *,
    config: DragConfig,
    normal: Array | None = None,
    height: float = 0.0,
) -> Array:
    """Return the force of the hand on the guided or held point, in W, N.

    Parameters
    ----------
    away : ndarray, shape (3,)
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
    f = config.stiffness * away - config.damping * velocity
    along = np.zeros(3)
    if normal is not None:
        f -= normal * (normal @ f)
        along_normal = config.normal_force + config.damping * float(normal @ velocity)
        along_normal += config.stiffness * float(np.clip(height, 0.0, _LIFT))
        along = -normal * np.clip(along_normal, -config.max_force, config.max_force)
    strength = float(np.linalg.norm(f))
    return f * min(1.0, config.max_force / max(strength, 1e-12)) + along
