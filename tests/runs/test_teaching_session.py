"""Facts about a session of teaching, driven without a page."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import FmpError, RunError
from fmp_drake.primitives import Demonstration, load_skill
from fmp_drake.runs import TeachingSession, teaching_session
from fmp_drake.station import CheckFeasibility, LoadScenario, SimulatedHand
from fmp_drake.systems import HandMotion

MOTION = HandMotion.make("eight", duration=30.0, seed=0)


def begin(*, press=10.0, **options):
    scenario = LoadScenario("table_top")
    scenario.press.force = press
    scenario.skill.window, scenario.skill.candidates = 1.0, 4
    return TeachingSession(
        scenario, SimulatedHand(MOTION), **{"clock": None, **options}
    )


def place(session):
    """Return the joints' angles and speeds."""
    station = session.simulator.get_system()
    if not station.HasOutputPort("state"):  # A run has its station in its diagram.
        station = station.GetSubsystemByName("wiping_station")
    context = station.GetMyContextFromRoot(session.simulator.get_context())
    return np.split(np.array(station.GetOutputPort("state").Eval(context)), 2)


def switch(session, mode):
    """Press the button of a mode, unless the session is in it."""
    if session.mode != mode:
        session.press(mode)


@pytest.fixture(scope="module")
def taught(tmp_path_factory):
    """A session that has learned and plays, and where its arm was before."""
    folder = tmp_path_factory.mktemp("taught")
    session = begin(out=folder / "shown.npz", skill_file=folder / "skill.npz")
    session.advance(2.5)
    before = place(session)[0]
    session.press("learn")
    return session, before, place(session), folder


def test_it_begins_with_teaching():
    session = begin()
    assert session.mode == "teach"
    assert session.buttons == ("learn", "again", "play", "save")
    assert session.skill is None
    assert session.missing == 2.0


def test_it_reports_the_missing_time_and_continues_teaching():
    session = begin()
    session.advance(1.2)
    session.press("learn")
    assert session.mode == "teach"
    assert "show 1 s more: learning needs at least two windows of 1 s" in session.remark
    session.press("play")
    assert session.mode == "teach"
    assert "learn first" in session.remark


def test_again_discards_the_demonstrations():
    session = begin()
    session.advance(1.0)
    assert session.demonstrations
    session.press("again")
    assert session.demonstrations == []
    session.advance(0.8)
    (shown,) = session.demonstrations
    assert 0.6 < shown.duration <= 0.8


def test_undo_restores_discarded_demonstrations():
    session, other = begin(), begin()
    for each in (session, other):
        each.advance(1.0)
    session.press("again")
    assert session.buttons == ("learn", "again", "play", "save", "undo")
    for each in (session, other):
        each.advance(0.5)
    session.press("undo")
    assert "undo" not in session.buttons
    (shown,), (expected,) = session.demonstrations, other.demonstrations
    assert np.array_equal(shown.values, expected.values)


def test_again_without_a_movement_discards_nothing():
    session = begin()
    session.press("again")
    assert not session.is_done
    assert "nothing was demonstrated" in session.remark
    assert "undo" not in session.buttons


def test_a_button_of_another_mode_is_refused():
    with pytest.raises(
        RunError, match=r"no button 'more' in the mode teach; press one"
    ):
        begin().press("more")


def test_after_learning_it_plays_from_where_the_arm_is(taught):
    session, before, (q, v), _ = taught
    assert session.mode == "play"
    assert "learned in" in session.remark
    assert np.array_equal(q, before)
    assert not v.any()


def test_movement_without_a_repeated_cycle_is_reported(taught):
    assert "no cycle was found: press more" in taught[0].remark
    session = begin()
    session.advance(8.0)
    session.press("learn")
    assert session.skill.rhythm_ is not None
    assert "no cycle" not in session.remark


def test_whether_the_arm_can_follow_is_asked_from_where_it_is(monkeypatch):
    asked = []

    def check(scenario, skill):
        asked.append(scenario)
        return CheckFeasibility(scenario, skill)

    monkeypatch.setattr(teaching_session, "CheckFeasibility", check)
    session = begin()
    session.advance(2.2)
    session.press("learn")
    eraser = session.simulator.get_system().GetSubsystemByName("wiping_station")
    context = eraser.GetMyContextFromRoot(session.simulator.get_context())
    x, y, z = eraser.GetOutputPort("measured_position").Eval(context)
    assert_allclose(asked[0].start, [x, y, max(z, 0.0)], atol=1e-12)
    assert LoadScenario("table_top").start != asked[0].start


@pytest.mark.parametrize(
    ("scenario", "out", "skill_file", "message"),
    [
        ("stir", "a.csv", "s.npz", "no place for the reference of the rotation"),
        ("table_top", "a.npz", "a.npz", "also the name of a demonstration"),
        ("table_top", "a.npz", "a_2.npz", "also the name of a demonstration"),
        ("table_top", "a.npz", "s.csv", "must end in .npz"),
    ],
)
def test_files_that_cannot_be_written_are_refused_first(
    scenario, out, skill_file, message, tmp_path
):
    out, skill_file = tmp_path / out, tmp_path / skill_file
    hand = SimulatedHand(MOTION)
    with pytest.raises(FmpError, match=message):
        TeachingSession(LoadScenario(scenario), hand, out=out, skill_file=skill_file)


def test_infeasibility_is_reported_after_learning():
    session = begin(press=60.0)
    session.advance(2.2)
    session.press("learn")
    assert session.mode == "play"
    duration_text, verdict = session.remark.split("; ", 1)
    assert "learned in" in duration_text
    assert "friction holds the eraser" in verdict


def test_taught_skill_is_saved_and_cleans_the_board(taught):
    session, _, _, folder = taught
    session.advance(1.0)
    assert "% of the demonstrated area is clean" in session.status
    assert "wiping: 0 %" not in session.status
    session.press("save")
    assert session.remark == "wrote shown.npz, skill.npz"
    assert Demonstration.load(folder / "shown.npz").frame == "board"
    assert load_skill(folder / "skill.npz").n_windows_ == session.skill.n_windows_


def test_it_alternates_between_teaching_and_playing(taught):
    session, *_ = taught
    switch(session, "play")
    skill = session.skill
    for _ in range(2):
        session.advance(0.1)
        before = place(session)[0]
        session.press("teach")
        assert session.mode == "teach"
        assert session.demonstrations == []
        assert np.array_equal(place(session)[0], before)
        session.advance(0.1)
        session.press("play")
        assert session.skill is skill


def test_more_is_learned_together_with_the_first(taught):
    session, *_ = taught
    switch(session, "teach")
    session.advance(2.4)
    session.press("learn")
    windows = session.skill.n_windows_
    session.press("more")
    assert session.mode == "teach"
    assert len(session.demonstrations) == 1
    session.advance(2.4)
    session.press("learn")
    assert session.skill.n_windows_ > 1.7 * windows


def test_nothing_to_save_is_reported(tmp_path):
    session = begin(out=tmp_path / "a.npz", skill_file=tmp_path / "b.npz")
    session.press("save")
    assert "nothing to save yet" in session.remark
    assert list(tmp_path.iterdir()) == []


def test_save_keeps_the_files_of_an_earlier_session(tmp_path):
    session = begin(out=tmp_path / "a.npz", skill_file=tmp_path / "b.npz")
    for name in ("a.npz", "a_2.npz", "b.npz", "b_2.npz"):
        (tmp_path / name).write_text("earlier")
    session.advance(1.0)
    session.press("save")
    assert session.remark == (
        "wrote a.npz; the earlier files are a.1.npz, a_2.1.npz, b.1.npz now"
    )
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"a.npz", "a.1.npz", "a_2.1.npz", "b.1.npz", "b_2.npz"}
    assert (tmp_path / "a_2.1.npz").read_text() == "earlier"
    assert Demonstration.load(tmp_path / "a.npz").duration > 0.8
    session.press("save")
    assert "saved already" in session.remark
    assert len(list(tmp_path.iterdir())) == 5


def test_a_new_movement_does_not_take_the_place_of_a_saved_one(taught):
    session, _, _, folder = taught
    switch(session, "play")
    session.press("save")
    before = Demonstration.load(folder / "shown.npz")
    session.press("teach")
    session.press("save")
    assert "saved already" in session.remark
    session.advance(1.0)
    session.press("save")
    assert len(Demonstration.load(folder / "shown.npz").time) < len(before.time)
    earlier_values = [
        Demonstration.load(path).values for path in folder.glob("shown.*.npz")
    ]
    assert any(np.array_equal(values, before.values) for values in earlier_values)


def test_write_error_is_reported_and_the_session_continues(tmp_path):
    session = begin(out=tmp_path / "missing" / "a.npz")
    session.advance(1.0)
    session.press("save")
    assert "cannot write" in session.remark
    assert session.mode == "teach"


def test_slow_machine_is_reported_and_the_rhythm_is_that_of_the_hand():
    ticks = iter(np.arange(0.0, 1000.0, 0.1))
    # One look at the clock for each sample: 20 samples in 2 s.
    session = begin(clock=lambda: float(next(ticks)))
    session.simulator.set_target_realtime_rate(0.0)
    session.advance(2.5)
    assert session.realtime_rate == pytest.approx(0.5, abs=0.03)
    assert "too slow to teach on (50 % of real time)" in session.status
    (shown,) = session.demonstrations
    assert shown.duration == pytest.approx(5.0, abs=0.3)


def test_what_was_shown_is_not_lost_by_play(taught):
    session, *_ = taught
    switch(session, "teach")
    session.advance(1.0)
    (shown,) = session.shown
    session.press("play")
    assert session.mode == "teach"
    assert "would be lost" in session.remark
    assert np.array_equal(session.shown[0].values, shown.values)
    session.press("again")
    session.press("play")
    assert session.mode == "play"


def test_a_skill_of_an_earlier_motion_is_called_so(taught):
    session, *_ = taught
    switch(session, "teach")
    session.advance(1.0)
    session.press("save")
    assert "skill.npz was learned from an earlier motion" in session.remark
    session.press("again")
