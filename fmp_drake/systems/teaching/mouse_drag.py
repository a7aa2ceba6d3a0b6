"""A drag of the mouse on the page: where it wants a point of the arm to be.

The page is not to be trusted: it may be slow, stand still, or say anything. What it says
moves a wanted point, whose speed, whose steps and whose way without a new message are
limited, and which is given up where the page falls silent or the cursor jumps.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# The smallest cosine between a ray and the normal of the plane that it is to meet.
_GRAZING = 0.08
# A body whose picture moved less than this, m, looks to a living page as if it stood still.
_STIRRED = 0.005
_SAME = 1e-9
# The height, m, up to which the spring pulls back to the board what leaves it.
_LIFT = 0.006


@dataclass(frozen=True, kw_only=True)
class DragConfig:
    """How the mouse holds the arm, and what it may not do.

    Attributes
    ----------
    stiffness, damping : float
        Of the spring to the wanted point, N/m and Ns/m.
    max_force : float
        N; in the plane of the board, where there is one.
    normal_force : float
        On the board, N.
    holds : bool
        Whether it keeps the arm where it lets go, or leaves it alone.
    max_speed : float
        Of the wanted point, m/s.
    max_jump : float
        Of the cursor from one message to the next, m; beyond it lets go.
    max_ahead : float
        How far the wanted point goes without a new message, m.
    patience : float
        After how long without a new message, although the arm moves, the page counts as
        gone, s.

    Examples
    --------
    >>> PULLING.max_force
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


LEADING = DragConfig(
    stiffness=2500.0, damping=250.0, max_force=60.0, normal_force=5.0, holds=True
)
"""A hand that leads an arm which is free to be led, and leaves it where it lets go."""

PULLING = DragConfig(stiffness=400.0, damping=40.0, max_force=40.0, max_jump=0.6)
"""A hand that disturbs an arm at work."""


class Drag(NamedTuple):
    """What the page says: a body, and the ends of its spring.

    Attributes
    ----------
    body : int
    point : ndarray, shape (3,)
        p_BoQ_B, what was grabbed as the page's last picture has it, m.
    anchor, cursor : ndarray, shape (3,)
        In W: the same point, and the cursor in the plane of the screen, m.
    """

    body: int
    point: Array
    anchor: Array
    cursor: Array


class BoardPlane(NamedTuple):
    """The board: the tool is led in parallel to it, and not beside it.

    Attributes
    ----------
    X_WB : ndarray, shape (3, 4)
    half_size : ndarray, shape (2,)
        Half of where the tool may be, along x and y of B, m.

    Examples
    --------
    >>> board = BoardPlane(np.eye(3, 4), np.array([0.2, 0.3]))
    >>> board.inside(np.array([0.5, 0.0, 0.1]))
    array([0.2, 0. , 0.1])
    """

    X_WB: Array
    half_size: Array

    def height(self, p_W: Array) -> float:
        """Return how far a point is over the board, m."""
        return float((p_W - self.X_WB[:, 3]) @ self.normal)

    @property
    def normal(self) -> Array:
        """The normal out of the board, in W."""
        return self.X_WB[:, 2]

    def inside(self, p_W: Array) -> Array:
        """Return the nearest point over the board."""
        R, p = self.X_WB[:, :3], self.X_WB[:, 3]
        p_B = R.T @ (p_W - p)
        p_B[:2] = np.clip(p_B[:2], -self.half_size, self.half_size)
        inside: Array = p + R @ p_B
        return inside


# Numbers of 8 bytes only: one array of floats holds them.
STATE = np.dtype(
    [
        ("started", "f8"),
        ("leading", "f8"),
        ("lost", "f8"),  # Let go by a jump: the button has to be released first.
        ("body", "f8"),
        ("point", "3f8"),  # p_BoQ_B of what was grabbed.
        ("message", "6f8"),  # Anchor and cursor.
        ("message_time", "f8"),
        ("here", "3f8"),  # Where the led point was then; as all below in W.
        ("cursor_time", "f8"),
        ("interval", "f8"),  # Between two cursors.
        ("eye", "3f8"),
        ("grabbed", "3f8"),
        ("offset", "3f8"),  # From what was grabbed to what is led.
        ("aim", "3f8"),
        ("goal", "3f8"),  # The aim, over the board.
        ("wanted", "3f8"),
        ("speed", "f8"),
        ("left", "f8"),  # Of the way without a new message.
    ]
)
"""What is remembered of a drag, as a structured type; see `follow`."""


def no_drag() -> Array:
    """Return the state before anything was read, shape (n,)."""
    state = np.zeros(1, STATE)
    state["message"] = np.nan
    state["interval"] = 1 / 60
    floats: Array = state.view(np.float64)
    return floats


def cursor_of(
    force: Array, *, anchor: Array, velocity: Array, mass: float, stiffness: float
) -> Array:
    """Return where the cursor is, from the force of Drake's mouse spring.

    Drake's spring pulls with ``m (k d - sqrt(k) v)``, and has no other way to say d.

    Parameters
    ----------
    force : ndarray, shape (3,)
        In W, N.
    anchor, velocity : ndarray, shape (3,)
        Of the point at which it pulls, in W, m and m/s.
    mass : float
        Of the body, kg.
    stiffness : float
        Of the spring for each kilogram, 1/s^2.
    """
    return anchor + force / (mass * stiffness) + velocity / np.sqrt(stiffness)


def slide(cursor: Array, *, eye: Array, point: Array, normal: Array) -> Array | None:
    """Return where the ray from the eye through the cursor meets a plane.

    On the screen "away" would otherwise mean "up".

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
    board: BoardPlane | None,
) -> Array:
    """Return the state after a look at the page.

    Parameters
    ----------
    state : ndarray, shape (n,)
    drag : Drag or None
        None where nothing is dragged.
    time, period : float
        Of the look, and between two, s.
    here : ndarray, shape (3,)
        The point that is led, in W, m.
    eye : ndarray, shape (3,)
        Of the page's camera, in W, m.
    config : DragConfig
    board : BoardPlane, optional
        None to follow the cursor in the plane of the screen.
    """
    floats = state.copy()
    s = floats.view(STATE)[0]
    if not s["started"]:
        # What is dragged before the beginning is old: wait until it says something new.
        s["started"], s["wanted"] = 1, here
        s["lost"] = 0
        s["message"] = np.nan if drag is None else np.r_[drag.anchor, drag.cursor]
        return floats
    if drag is None:
        _let_go(s, here)
        s["lost"], s["message"] = 0, np.nan
        return floats
    message = np.r_[drag.anchor, drag.cursor]
    is_new = not np.all(np.abs(message - s["message"]) < _SAME)
    moved_cursor = not np.all(np.abs(message[3:] - s["message"][3:]) < _SAME)
    if s["leading"] and s["body"] != drag.body:
        _let_go(s, here)
    if s["lost"] or not (is_new or s["leading"]):
        return floats
    if is_new:
        grabs = not s["leading"]
        if grabs:
            s["leading"], s["body"], s["point"] = 1, drag.body, drag.point
            s["eye"], s["grabbed"], s["offset"] = eye, drag.anchor, here - drag.anchor
            s["aim"] = s["wanted"] = here
            s["cursor_time"] = time
        s["message"], s["message_time"], s["here"] = message, time, here
        s["left"] = config.max_ahead
        if grabs or moved_cursor:
            _aim(s, drag.cursor, time, period, config, board)
            if s["lost"]:
                _let_go(s, here)
                return floats
    elif (
        time - s["message_time"] > config.patience
        and np.linalg.norm(here - s["here"]) > _STIRRED
    ):
        _let_go(s, here)
        return floats
    way = s["goal"] - s["wanted"]
    distance = float(np.linalg.norm(way))
    step = min(s["speed"] * period, s["left"], distance)
    if step > 0:
        s["wanted"] += step / distance * way
        s["left"] -= step
    return floats


def _aim(
    s: Any,
    cursor: Array,
    time: float,
    period: float,
    config: DragConfig,
    board: BoardPlane | None,
) -> None:
    """Take over a new cursor: reach it when the next one comes."""
    aim: Array | None = cursor
    if board is not None:
        aim = slide(cursor, eye=s["eye"], point=s["grabbed"], normal=board.normal)
    if aim is None or np.linalg.norm(aim + s["offset"] - s["aim"]) > config.max_jump:
        s["lost"] = 1
        return
    s["aim"] = aim + s["offset"]
    s["goal"] = s["aim"] if board is None else board.inside(s["aim"])
    if 0 < (since := time - s["cursor_time"]) <= config.patience:
        s["interval"] = (s["interval"] + since) / 2
    s["cursor_time"] = time
    distance = float(np.linalg.norm(s["goal"] - s["wanted"]))
    s["speed"] = min(config.max_speed, distance / max(s["interval"], period))


def _let_go(s: Any, here: Array) -> None:
    if s["leading"]:
        s["leading"], s["wanted"] = 0, here


def hand_force(
    away: Array,
    velocity: Array,
    *,
    config: DragConfig,
    normal: Array | None = None,
    height: float = 0.0,
) -> Array:
    """Return the force of the hand on the point that it leads or holds, in W, N.

    Parameters
    ----------
    away : ndarray, shape (3,)
        From the point to where it is wanted, in W, m.
    velocity : ndarray, shape (3,)
        Of the point, in W, m/s.
    config : DragConfig
    normal : ndarray, shape (3,), or None
        Out of the board, in W: the spring acts in its plane, and along it the hand
        presses and damps. None for a spring in all directions.
    height : float
        Of the point over the board, m; on a tool that has left it the hand presses more.
    """
    f = config.stiffness * away - config.damping * velocity
    along = np.zeros(3)
    if normal is not None:
        f -= normal * (normal @ f)
        press = config.normal_force + config.damping * float(normal @ velocity)
        press += config.stiffness * float(np.clip(height, 0.0, _LIFT))
        along = -normal * np.clip(press, -config.max_force, config.max_force)
    strength = float(np.linalg.norm(f))
    return f * min(1.0, config.max_force / max(strength, 1e-12)) + along
