"""Facts about what a drag on the page may do to the arm, without an arm."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fmp_drake.systems.surface.surface import Surface, place
from fmp_drake.systems.teaching.mouse_drag import (
    GUIDING_DRAG,
    PULLING_DRAG,
    STATE,
    BoardSurface,
    Drag,
    cursor_of,
    follow,
    hand_force,
    no_drag,
    ray_intersection,
)

PERIOD = 0.016
EYE = np.array([1.0, 0.0, 1.0])
UP = np.array([0.0, 0.0, 1.0])
BOARD = BoardSurface(np.eye(3, 4), np.array([0.2, 0.3]))


class Hand:
    """The hand of a page, on a point that follows as if it had no mass, or does not move."""

    def __init__(self, config=GUIDING_DRAG, board=BOARD, *, stands=False):
        self.state, self.time, self.stands = no_drag(), 0.0, stands
        self.guided_point = np.zeros(3)
        self.config, self.board = config, board
        self.look(None)

    def look(self, drag):
        self.state = follow(
            self.state,
            drag,
            time=self.time,
            period=PERIOD,
            guided_point=self.guided_point,
            eye=EYE,
            config=self.config,
            board=self.board,
        )
        self.time += PERIOD
        if self["guiding"] and not self.stands:
            self.guided_point = np.array(self["set_point"])
        return self

    def __getitem__(self, name):
        return self.state.view(STATE)[0][name]

    def over(self, x, y, *, anchor=(0, 0, 0)):
        """Look at a page whose cursor is over a point of the board."""
        p, look = np.array([x, y, 0.0]), -EYE
        ray = p - EYE
        cursor = EYE + ray * (look @ look) / (ray @ look)
        return self.look(Drag(5, np.zeros(3), np.array(anchor, dtype=float), cursor))

    def silent(self, seconds, x, y):
        for _ in range(round(seconds / PERIOD)):
            self.over(x, y)
        return self

    def dragged(self, x, y, *, steps=20, each=1):
        """Drag to a point, the page's pictures some readings apart."""
        for i in range(1, steps + 1):
            for _ in range(each):
                self.over(x * i / steps, y * i / steps)
        return self


def test_the_cursor_is_found_from_the_springs_force():
    anchor, velocity, cursor = np.random.default_rng(0).normal(size=(3, 3))
    force = 2.5 * (100 * (cursor - anchor) - 10 * velocity)
    found = cursor_of(force, anchor=anchor, velocity=velocity, mass=2.5, stiffness=100)
    assert_allclose(found, cursor)


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0.6, 0.8], [1, 0, 0]])
def test_a_slid_point_is_in_the_plane_and_under_the_cursor(normal):
    normal, point = np.array(normal, dtype=float), np.array([0.1, 0.2, 0.05])
    cursor = np.array([0.2, 0.1, 0.3])
    found = ray_intersection(cursor, eye=EYE, point=point, normal=normal)
    assert (found - point) @ normal == pytest.approx(0, abs=1e-12)
    assert_allclose(np.cross(found - EYE, cursor - EYE), 0, atol=1e-12)


@pytest.mark.parametrize("cursor", [(2, 0, 1), (2, 0, 0.99), (1, 0, 2)])
def test_a_ray_that_grazes_the_board_or_leaves_it_meets_nothing(cursor):
    assert (
        ray_intersection(np.array(cursor), eye=EYE, point=np.zeros(3), normal=UP)
        is None
    )


def test_a_drag_guides_to_the_cursor_over_the_board():
    hand = Hand().dragged(0.1, -0.15)
    assert hand["guiding"]
    hand.silent(0.1, 0.1, -0.15)
    assert_allclose(hand["set_point"], [0.1, -0.15, 0], atol=1e-9)


def test_drag_beside_the_tool_moves_it_by_the_same_distance():
    hand = Hand()
    hand.guided_point = np.array([0.02, 0.0, -0.3])
    hand.dragged(0.05, 0.08).silent(0.1, 0.05, 0.08)
    assert_allclose(hand["set_point"], [0.07, 0.08, -0.3], atol=1e-9)


def test_the_set_point_never_moves_faster_than_the_limit():
    hand, before, fastest = Hand(), np.zeros(3), 0.0
    for i in range(60):
        hand.over(0.15 * np.sin(0.4 * i), 0.15 * np.cos(0.4 * i) - 0.15)
        fastest = max(fastest, np.linalg.norm(hand["set_point"] - before))
        before = np.array(hand["set_point"])
    assert fastest == pytest.approx(GUIDING_DRAG.max_speed * PERIOD)


@pytest.mark.parametrize("each", [1, 3, 6, 12])
def test_a_slow_page_guides_as_steadily_as_a_fast_one(each):
    hand, x = Hand(), []
    for i in range(240):
        t = i // each * each * PERIOD
        hand.over(0.15 * np.sin(2 * t), 0)
        x.append(hand["set_point"][0])
    x, now = np.array(x)[60:], np.arange(60, 240)
    errors = [
        np.abs(x - 0.15 * np.sin(2 * PERIOD * (now - lag))).max() for lag in range(30)
    ]
    assert np.argmin(errors) <= 2 * each
    # Of 6 mm from picture to picture at 60 of them in a second, 58 mm at 5.
    assert min(errors) < 0.001 + 0.0006 * each
    # No standing still between pictures.
    steps = np.abs(np.diff(x))[:40]
    assert np.mean(steps < 1e-5) < 0.2


def test_silent_page_moves_the_arm_at_most_to_the_limit_and_then_releases_it():
    hand = Hand().over(0, 0).over(0.19, 0)
    hand.silent(2.0, 0.19, 0)
    assert not hand["guiding"]
    assert 0.03 < hand.guided_point[0] <= GUIDING_DRAG.max_travel + 1e-9


def test_silent_page_continues_after_a_new_message():
    hand = Hand().over(0, 0).over(0.12, 0)
    hand.silent(2.0, 0.12, 0)
    hand.over(0.121, 0, anchor=hand.guided_point)
    assert hand["guiding"]


def test_a_still_mouse_on_a_still_arm_is_not_a_silent_page():
    hand = Hand().dragged(0.1, 0).silent(0.2, 0.1, 0)
    at = hand.guided_point.copy()
    hand.over(0.1, 0, anchor=at).silent(5.0, 0.1, 0)
    assert hand["guiding"]
    assert_allclose(hand.guided_point, at, atol=1e-6)


def test_jump_of_the_cursor_ends_the_drag_until_the_next_one():
    hand = Hand().dragged(0.05, 0)
    hand.over(-0.19, 0.25)
    assert not hand["guiding"]
    at = hand.guided_point.copy()
    hand.dragged(0.05, 0)
    assert not hand["guiding"]
    assert_array_equal(hand["set_point"], at)
    hand.look(None)
    hand.over(0, 0)
    assert hand["guiding"]


def test_cursor_at_the_horizon_ends_the_drag():
    hand = Hand().dragged(0.05, 0)
    hand.look(Drag(5, np.zeros(3), np.zeros(3), np.array([2.0, 0, 1])))
    assert not hand["guiding"]


def test_tool_is_guided_up_to_the_edge_of_the_board():
    hand = Hand().dragged(0.5, 0, steps=100).silent(0.2, 0.5, 0)
    assert hand["guiding"]
    assert_allclose(hand["set_point"], [0.2, 0, 0], atol=1e-9)
    for i in range(60):
        hand.over(0.5 - 0.01 * i, 0)
    assert hand["set_point"][0] < 0


def test_after_a_drag_the_position_is_held():
    hand = Hand().dragged(0.1, 0.1)
    at = hand.guided_point.copy()
    hand.look(None)
    assert not hand["guiding"]
    assert_array_equal(hand["set_point"], at)


def test_a_drag_from_before_the_beginning_does_nothing_until_it_moves():
    hand = Hand()
    hand.state = no_drag()
    hand.silent(1.0, 0.1, 0)
    assert not hand["guiding"]


def test_camera_of_another_page_does_not_rotate_the_drag():
    hand = Hand().over(0, 0)
    for _ in range(20):
        hand.state = follow(
            hand.state,
            None if not hand["guiding"] else Drag(5, *np.zeros((3, 3))),
            time=hand.time,
            period=PERIOD,
            guided_point=hand.guided_point,
            eye=np.array([-3.0, 0.0, 0.4]),
            config=GUIDING_DRAG,
            board=BOARD,
        )
    assert_array_equal(hand["eye"], EYE)


def test_two_bodies_are_two_drags():
    hand = Hand(PULLING_DRAG, None)
    hand.look(Drag(3, np.zeros(3), np.zeros(3), np.zeros(3)))
    hand.look(Drag(4, np.ones(3), np.ones(3), np.ones(3)))
    assert hand["body"] == 4
    assert_array_equal(hand["point"], np.ones(3))


@pytest.mark.parametrize("normal", [None, UP, np.array([0.6, 0, 0.8])])
def test_no_message_can_make_the_force_greater_than_the_limit(normal):
    rng = np.random.default_rng(1)
    for _ in range(50):
        away, velocity = rng.normal(size=(2, 3)) * [[10.0], [3.0]]
        f = hand_force(away, velocity, config=GUIDING_DRAG, normal=normal)
        along = 0.0 if normal is None else normal @ f
        across = f if normal is None else f - along * normal
        assert np.linalg.norm(across) <= GUIDING_DRAG.max_force + 1e-9
        assert abs(along) <= GUIDING_DRAG.max_force + 1e-9


@pytest.mark.parametrize(("height", "press"), [(-0.01, 5), (0.004, 15), (0.3, 20)])
def test_the_hand_presses_brakes_and_holds_the_tool_on_the_board(height, press):
    f = hand_force(
        np.array([0.01, 0, 0.5]),
        np.array([0, 0.1, 0]),
        config=GUIDING_DRAG,
        normal=UP,
        height=height,
    )
    assert_allclose(f, [25.0, -25.0, -press])


CURVED = {
    "pipe": Surface(kx=0.0, ky=1 / 0.3),
    "dome": Surface(kx=4.0, ky=4.0),
    "bowl": Surface(kx=-3.0, ky=-3.0),
}


@pytest.mark.parametrize("shape", CURVED)
def test_cursor_over_a_curved_board_slides_along_it(shape):
    surface = CURVED[shape]
    board = BoardSurface(np.eye(3, 4), np.array([0.2, 0.2]), surface)
    # Grabbed 1 cm over the board, dragged to another point as high.
    grabbed, goal = place(surface, np.array([[0.0, 0.0, 0.01], [0.08, -0.06, 0.01]]))
    cursor = EYE + 0.7 * (goal - EYE)
    assert_allclose(
        board.ray_intersection(cursor, eye=EYE, point=grabbed), goal, atol=1e-12
    )
    assert_allclose(board.coordinates(goal), [0.08, -0.06, 0.01], atol=1e-12)
    assert board.height(goal) == pytest.approx(0.01)
    # The normal is the direction in which the height grows fastest.
    slope = [
        (board.height(goal + d) - board.height(goal - d)) / 2e-6
        for d in 1e-6 * np.eye(3)
    ]
    assert_allclose(board.normal(goal), slope, atol=1e-6)


@pytest.mark.parametrize("shape", CURVED)
def test_goal_stays_within_the_edges_of_a_curved_board(shape):
    surface = CURVED[shape]
    board = BoardSurface(np.eye(3, 4), np.array([0.1, 0.05]), surface)
    beyond = place(surface, np.array([[0.15, 0.02, 0.01]]))[0]
    inside = board.clamped(beyond)
    assert_allclose(board.coordinates(inside), [0.1, 0.02, 0.01], atol=1e-12)


def test_ray_past_a_dome_stays_at_its_edge_and_behind_the_eye_there_is_nothing():
    board = BoardSurface(np.eye(3, 4), np.array([0.3, 0.3]), CURVED["dome"])
    past = board.ray_intersection(np.array([0.5, 0.6, 0.5]), eye=EYE, point=np.zeros(3))
    centre = np.array([0.0, 0.0, -0.25])
    ray = np.array([0.5, 0.6, 0.5]) - EYE
    nearest = EYE + ray * ((centre - EYE) @ ray) / (ray @ ray)
    assert_allclose(past, nearest, atol=1e-12)
    assert board.ray_intersection(2 * EYE, eye=EYE, point=np.zeros(3)) is None


def test_tool_is_pressed_along_the_local_normal_of_a_pipe():
    board = BoardSurface(np.eye(3, 4), np.array([0.2, 0.3]), CURVED["pipe"])
    here = place(CURVED["pipe"], np.array([[0.0, 0.15, 0.0]]))[0]
    normal = board.normal(here)
    assert_allclose(normal, [0.0, np.sin(0.5), np.cos(0.5)], atol=1e-12)
    f = hand_force(np.zeros(3), np.zeros(3), config=GUIDING_DRAG, normal=normal)
    assert_allclose(f, -GUIDING_DRAG.normal_force * normal, atol=1e-12)


def test_drag_of_the_page_leads_over_a_dome():
    surface = CURVED["dome"]
    hand = Hand(board=BoardSurface(np.eye(3, 4), np.array([0.2, 0.2]), surface))
    goals = place(surface, np.array([[0.002 * i, 0.0, 0.0] for i in range(60)]))
    for goal in goals:
        hand.look(Drag(5, np.zeros(3), np.zeros(3), EYE + 0.5 * (goal - EYE)))
    for _ in range(10):
        hand.look(Drag(5, np.zeros(3), np.zeros(3), EYE + 0.5 * (goals[-1] - EYE)))
    assert hand["guiding"]
    assert_allclose(hand.guided_point, goals[-1], atol=1e-3)


class TurningHand(Hand):
    """A hand that has grabbed a tool 0.3 m above its end, to turn it."""

    grabbed = np.array([0.0, 0.0, 0.3])

    def __init__(self, rotation=(0.0, 0.0, 0.0), **options):
        self.rotation = np.array(rotation)
        super().__init__(**options)
        self.to(0.0, 0.0)

    def look(self, drag):
        self.state = follow(
            self.state,
            drag,
            time=self.time,
            period=PERIOD,
            guided_point=self.guided_point,
            eye=EYE,
            config=self.config,
            board=self.board,
            rotation=self.rotation,
            turns_tool=True,
        )
        self.time += PERIOD
        return self

    def to(self, x, y):
        """Look at a page whose cursor is over a point as high as the grabbed one."""
        cursor = EYE + 0.5 * (self.grabbed + np.array([x, y, 0.0]) - EYE)
        return self.look(Drag(5, np.zeros(3), self.grabbed, cursor))

    def turned(self, x, y, *, steps=40):
        """Move the cursor to a point, and wait."""
        for i in range(1, steps + 1):
            self.to(x * i / steps, y * i / steps)
        for _ in range(10):
            self.to(x, y)
        return np.array(self["rotation"])


@pytest.mark.parametrize(
    ("way", "rotation"),
    [
        ((0.06, 0.0), (0, 0.2, 0)),
        ((0.0, 0.06), (-0.2, 0, 0)),
        ((-0.03, 0), (0, -0.1, 0)),
    ],
)
def test_grabbed_point_follows_the_cursor_around_the_end_of_the_tool(way, rotation):
    hand = TurningHand()
    assert_allclose(hand.turned(*way), rotation, atol=1e-9)
    assert_array_equal(hand["set_point"], np.zeros(3))


def test_tool_is_turned_from_its_present_orientation_and_keeps_it():
    hand = TurningHand(rotation=(0.0, 0.2, 0.0))
    assert_allclose(hand.turned(0.06, 0.0), [0, 0.4, 0], atol=1e-9)
    hand.look(None)
    assert not hand["guiding"]
    assert_allclose(hand["rotation"], [0, 0.4, 0], atol=1e-9)


def test_tool_is_turned_neither_faster_nor_farther_than_allowed():
    hand, leans = TurningHand(), []
    for i in range(60):
        hand.to(0.01 * i, 0.0)
        leans.append(np.linalg.norm(hand["rotation"]))
    rate = np.max(np.abs(np.diff(leans))) / PERIOD
    assert rate == pytest.approx(GUIDING_DRAG.max_angular_speed, rel=1e-6)
    assert leans[-1] == pytest.approx(GUIDING_DRAG.max_rotation)


def test_silent_page_does_not_turn_the_tool_farther():
    hand = TurningHand()
    hand.to(0.15, 0.0)
    for _ in range(100):
        hand.to(0.15, 0.0)
    assert 0.1 < np.linalg.norm(hand["rotation"]) < 0.31
    assert not hand["guiding"]


def test_cursor_that_jumps_ends_the_turning():
    hand = TurningHand()
    hand.to(0.5, 0.5)
    assert not hand["guiding"]
    assert_array_equal(hand["rotation"], np.zeros(3))
