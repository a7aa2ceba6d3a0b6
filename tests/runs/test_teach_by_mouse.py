"""Facts about teaching with the mouse, with a page that needs no browser.

All shapes, boards and cameras, and 60 s of play: `tests/benchmarks/teach_by_mouse.py`.
"""

import numpy as np
import pytest
from page_mouse import TaughtSession

from fmp_drake.station import LoadScenario
from fmp_drake.systems.mouse_hand import TURN_SWITCH

pytestmark = pytest.mark.slow

ABUSED = 0.10  # How far the arm may move by itself, m.


def begin(board="table_top", **options):
    scenario = LoadScenario(board)
    scenario.skill.window, scenario.skill.candidates = 2.0, 4
    taught = TaughtSession(scenario, **options)
    taught.session.advance(1.2)
    return taught


@pytest.mark.parametrize(
    ("board", "shape", "frames", "latency", "error"),
    [("table_top", "eight", 60, 0.05, 0.005), ("vertical", "square", 10, 0.1, 0.015)],
)
def test_dragged_motion_is_recorded_learned_and_wiped(
    board, shape, frames, latency, error
):
    eye = [-0.85, 1.45, 1.2] if board == "vertical" else None
    taught = begin(board, frames=frames, latency=latency, eye=eye)
    taught.press("panda/panda_link6" if board == "vertical" else "eraser/eraser")
    taught.drag(shape, 4.6)
    taught.release()
    assert taught.recording_error(settle=1.5) < error
    assert max(taught.worst.values()) < 1
    (shown,) = taught.session.demonstrations
    assert np.ptp(shown.values[20:, 2]) < 0.006
    taught.session.press("learn")
    assert taught.session.mode == "play"
    taught.session.advance(2.0)
    assert "wiping: 0 %" not in taught.session.status


def test_pulls_during_playback_are_learned():
    taught = begin(panel=True)
    taught.press()
    taught.drag("circle", 4.3)
    taught.release()
    taught.session.press("learn")
    windows = taught.session.skill.n_windows_
    taught.session.advance(0.3)
    taught.press()
    taught.drag("circle", 2.5, size=0.5)
    assert taught.session.is_guided
    taught.session.press("more")
    assert taught.session.mode == "play"
    assert "learned in" in taught.session.remark
    assert taught.session.skill.n_windows_ > windows
    taught.session.press("more")
    assert taught.session.mode == "teach"
    assert len(taught.session.demonstrations) == 2
    taught.panel.close()


@pytest.fixture(scope="module")
def abused():
    """A session that somebody is not kind to."""
    return begin()


@pytest.fixture
def dragged(abused):
    """The session, in the middle of a drag near the middle of the board."""
    abused.session.press("again")
    x, y, _ = abused.tip()
    abused.press()
    for k in np.linspace(0, 1, 40):
        abused.frame([k * (0.05 - x), -k * y])
    yield abused
    abused.release()
    abused.session.advance(0.5)
    assert max(abused.worst.values()) < 1


def moved(taught, seconds, say=lambda: None, *, steps=20):
    """Return how far the eraser gets from where it is within some time, m."""
    start, farthest = taught.tip(), 0.0
    for _ in range(steps):
        say()
        taught.session.advance(seconds / steps)
        farthest = max(farthest, np.linalg.norm(taught.tip() - start))
    return farthest


def test_page_frozen_during_a_drag_releases_the_arm_and_can_continue(dragged):
    dragged.frame([0.0, 0.15])
    assert moved(dragged, 1.2) < ABUSED
    assert not dragged.session.is_guided
    at = dragged.tip()
    assert moved(dragged, 1.0) < 0.005
    # Reloaded: it says that nothing is dragged, and is dragged anew.
    dragged.mouse.release()
    dragged.session.advance(0.1)
    dragged.press()
    for k in np.linspace(0, 0.08, 50):
        dragged.frame([k, 0])
    assert dragged.session.is_guided
    one, two = dragged.session.demonstrations
    assert np.linalg.norm(two.values[0, :2] - at[:2]) < 0.02
    for shown in (one, two):
        assert np.linalg.norm(np.diff(shown.values, axis=0), axis=1).max() < 0.05


def test_a_cursor_that_jumps_over_the_screen_does_not_move_the_arm(dragged):
    rng = np.random.default_rng(0)
    first = moved(dragged, 0.5, lambda: dragged.frame([0.4, -0.5]))
    assert first < ABUSED
    assert not dragged.session.is_guided
    wild = moved(dragged, 1.0, lambda: dragged.frame(rng.uniform(-1, 1, 2)))
    assert wild < ABUSED


def test_a_button_that_is_released_outside_the_window_leaves_the_arm_on_the_board(
    dragged,
):
    for k in np.linspace(0, 1.5, 100):
        dragged.frame([0.0, k])
    dragged.mouse.release()
    dragged.session.advance(0.5)
    assert abs(dragged.tip()[1]) < 0.33
    assert moved(dragged, 1.0) < 0.01


def test_two_pages_that_drag_at_once_exceed_no_limit(dragged):
    sides = iter(np.tile([-0.15, 0.15], 1000))
    assert moved(dragged, 1.0, lambda: dragged.frame([0.05, next(sides)])) < ABUSED


def test_invalid_messages_of_a_page_are_ignored(dragged):
    here = dragged.pose("eraser/eraser").translation()
    ways = np.array([[0, 0, 1e9], [np.inf, 0, 0], [-5, -5, -5]])
    far = iter([*(here + ways)] * 20)
    assert moved(dragged, 0.5, lambda: dragged.mouse.send(here, next(far))) < ABUSED


def test_handle_of_a_spoon_is_guided_learned_and_played():
    taught = begin("stir")
    session, tip = taught.session, taught.tip()
    taught.meshcat.SetSliderValue(TURN_SWITCH, 1.0)
    taught.press("spoon/spoon", lift=(0.0, 0.0, 0.0))
    taught.drag("circle", 7.0, size=0.9)
    taught.release()
    # The end of the spoon stays where it is, and its handle goes round.
    (leant,) = session.demonstrations
    assert np.max(np.abs(taught.tip() - tip)) < 0.02
    assert leant.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert np.all(np.ptp(leant.values[20:], axis=0)[3:5] > 0.5)
    assert max(taught.worst.values()) < 1
    session.press("learn")
    assert session.mode == "play", session.remark
    assert session.skill.n_channels_ == 6
    station, errors = taught.station, []
    for _ in range(30):
        session.advance(0.1)
        context = station.GetMyContextFromRoot(taught.simulator.get_context())
        errors.append(station.GetOutputPort("tracking_error").Eval(context))
    turned, moved = np.split(np.square(errors), 2, axis=1)
    assert np.degrees(np.sqrt(np.mean(np.sum(turned, axis=1)))) < 0.6
    assert np.sqrt(np.mean(np.sum(moved, axis=1))) < 0.0015


def test_tool_that_was_turned_is_moved_as_it_leans():
    taught = begin("stir")
    taught.meshcat.SetSliderValue(TURN_SWITCH, 1.0)
    taught.press("spoon/spoon", lift=(0.0, 0.0, 0.0))
    for i in range(60):
        taught.frame([0.001 * i, 0.0])
    taught.release()
    taught.meshcat.SetSliderValue(TURN_SWITCH, 0.0)
    taught.press("spoon/spoon", lift=(0.0, 0.0, 0.0))
    taught.drag("circle", 4.0, size=0.6)
    taught.release()
    *_, moved = taught.session.demonstrations
    spread = np.ptp(moved.values[20:], axis=0)
    assert np.all(spread[:2] > 0.08)
    assert spread[2] < 0.005
    assert np.all(spread[3:] < 0.3)  # The hand's spring gives way.
    assert abs(np.median(moved.values[20:, 4])) > 0.1


def test_a_tool_that_was_not_turned_is_recorded_without_its_orientation():
    taught = begin("stir")
    taught.press("spoon/spoon", lift=(0.0, 0.0, 0.0))
    taught.drag("circle", 3.0, size=0.6)
    taught.release()
    (shown,) = taught.session.demonstrations
    assert shown.channels == ("x", "y", "z")


def test_mouse_on_a_dome_keeps_the_speeds_of_the_joints():
    taught = TaughtSession(LoadScenario("wipe_dome"))
    taught.session.advance(1.0)
    taught.worst.clear()
    taught.press()
    taught.drag("circle", 3.0, size=1.3, tempo=4.0)  # 0.7 m/s
    assert taught.session.is_guided
    assert taught.worst["speed"] < 1.0
