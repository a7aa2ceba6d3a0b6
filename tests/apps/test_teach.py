"""Facts about `fmp-drake teach`, and its page in a browser."""

import os
import shlex
import signal
import time

import numpy as np
import pytest
import umsgpack
from browser import CTRL, SHIFT, Page, needs_chromium

from fmp_drake.apps.page import open_page
from fmp_drake.primitives import Demonstration, load_skill
from fmp_drake.primitives.data.files import keep_earlier_files
from fmp_drake.runs import TeachingSession
from fmp_drake.runs.teach_page import TeachPage
from fmp_drake.station import LoadScenario, MouseOnPage, SimulatedHand
from fmp_drake.systems import HandMotion
from fmp_drake.systems.mouse_hand import TURN_SWITCH

STUB = (
    "viewer.renderer.kept = viewer.renderer.render; viewer.renderer.render = () => {};"
)
MIDDLE = """(() => {
  const button = document.querySelector("[data-name=%s]");
  button.scrollIntoView({block: "center"});
  const r = button.getBoundingClientRect();
  return [(r.left + r.right) / 2, (r.top + r.bottom) / 2];
})()"""
DRAW = "viewer.renderer.render = viewer.renderer.kept; viewer.set_dirty();"


def eight(_meshcat):
    """Return a hand that shows an 8, in place of the mouse."""
    return SimulatedHand(HandMotion.make("eight", duration=20.0, seed=0))


@pytest.mark.slow
def test_page_opens_and_its_address_is_printed(command, outputs):
    result = command(
        *("teach", "--duration", 0.2, "--out", outputs / "a.npz"),
        *("--skill", outputs / "b.npz"),
    )
    assert result.code == 0
    assert "teach it at http://localhost:" in result.out
    assert list(outputs.iterdir()) == []


@pytest.fixture
def short_windows(tmp_path):
    """A scenario with windows that are shown in a second."""
    path = tmp_path / "short.yaml"
    path.write_text("skill: {window: 1.0}")
    return "--scenario", path


@pytest.mark.slow
def test_an_accidental_drag_is_not_saved_at_the_end(command, outputs, monkeypatch):
    monkeypatch.setattr("fmp_drake.apps.teach.MouseOnPage", eight)
    options = ("--out", outputs / "a.npz", "--skill", outputs / "b.npz")
    (outputs / "a.npz").write_text("earlier")
    result = command("teach", "--duration", 2.0, *options)
    assert (result.code, "save:" in result.out) == (0, False)
    assert [path.name for path in outputs.iterdir()] == ["a.npz"]
    assert (outputs / "a.npz").read_text() == "earlier"


@pytest.mark.slow
@pytest.mark.parametrize("is_interrupted", [False, True])
def test_what_was_taught_is_saved_at_the_end(
    command, outputs, monkeypatch, short_windows, is_interrupted
):
    def interrupt(_, session):
        if is_interrupted and session.simulator.get_context().get_time() > 2.5:
            raise KeyboardInterrupt

    monkeypatch.setattr("fmp_drake.apps.teach.MouseOnPage", eight)
    monkeypatch.setattr(TeachPage, "press_clicked_button", interrupt)
    options = ("--out", outputs / "a.npz", "--skill", outputs / "b.npz")
    result = command("teach", "--duration", 3.0, *short_windows, *options)
    assert result.code == (130 if is_interrupted else 0)
    assert "save: wrote a.npz" in result.out
    assert [path.name for path in outputs.iterdir()] == ["a.npz"]
    assert Demonstration.load(outputs / "a.npz").duration > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("is_interrupted", [False, True])
def test_what_cannot_be_saved_at_the_end_is_reported(
    command, outputs, monkeypatch, short_windows, is_interrupted
):
    """It was lost without a word, with exit code 0 after a duration."""
    panels, folder = [], outputs / "folder"
    folder.mkdir()

    def open_and_keep(*arguments, **options):
        panels.append(open_page(*arguments, **options))
        return panels[-1]

    def interrupt(_, session):
        if session.simulator.get_context().get_time() > 2.5:
            if folder.exists():
                folder.rmdir()
            if is_interrupted:
                os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("fmp_drake.apps.teach.open_page", open_and_keep)
    monkeypatch.setattr("fmp_drake.apps.teach.MouseOnPage", eight)
    monkeypatch.setattr(TeachPage, "press_clicked_button", interrupt)
    options = ("--out", folder / "a.npz", "--skill", outputs / "b.npz")
    result = command("teach", "--duration", 3.0, *short_windows, *options)
    assert result.code == (130 if is_interrupted else 2)
    assert f"save: cannot write {folder / 'a.npz'}" in result.out
    assert panels[0].shown["messages"][-1]["text"] in result.out
    if not is_interrupted:
        assert result.err == "fmp-drake: what was taught is not saved.\n"


@pytest.mark.slow
def test_a_second_interrupt_does_not_end_the_saving(
    command, outputs, monkeypatch, short_windows
):
    """Earlier files were renamed, and no new ones written."""

    def interrupt(_, session):
        if session.simulator.get_context().get_time() > 2.5:
            os.kill(os.getpid(), signal.SIGINT)

    def interrupt_again(*paths):
        os.kill(os.getpid(), signal.SIGINT)
        return keep_earlier_files(*paths)

    monkeypatch.setattr("fmp_drake.apps.teach.MouseOnPage", eight)
    monkeypatch.setattr(TeachPage, "press_clicked_button", interrupt)
    place = "fmp_drake.runs.teaching_session.keep_earlier_files"
    monkeypatch.setattr(place, interrupt_again)
    (outputs / "a.npz").write_text("")
    options = ("--out", outputs / "a.npz", "--skill", outputs / "b.npz")
    result = command("teach", *short_windows, *options)
    assert result.code == 130
    assert "save: wrote a.npz; the earlier files are a.1.npz now" in result.out
    assert Demonstration.load(outputs / "a.npz").duration > 1.0


@pytest.mark.slow
def test_end_names_the_command_that_plays_what_was_learned(
    command, outputs, monkeypatch, short_windows
):
    def learn_once(_, session):
        is_late = session.simulator.get_context().get_time() > 3.5
        if is_late and session.skill is None:
            session.press("learn")

    monkeypatch.setattr("fmp_drake.apps.teach.MouseOnPage", eight)
    monkeypatch.setattr(TeachPage, "press_clicked_button", learn_once)
    options = ("--out", outputs / "a.npz", "--skill", outputs / "b.npz")
    result = command("teach", "--duration", 4.0, *short_windows, *options)
    flags = shlex.join(map(str, short_windows))
    last = result.out.splitlines()[-1]
    assert last == f"next: fmp-drake wipe {flags} --skill {outputs / 'b.npz'}"


def test_effect_of_each_button_is_described(command, outputs, monkeypatch):
    pressed, panels = [], []

    def open_and_press(*arguments, **options):
        panel = open_page(*arguments, **options)
        panels.append(panel)
        show = panel.show

        def press_once(**fields):
            show(**fields)
            if "learn" in fields.get("buttons", {}) and not pressed:
                pressed.append({"type": "button", "name": "learn"})
                panel.meshcat._InjectWebsocketMessage(umsgpack.packb(pressed[0]))

        monkeypatch.setattr(panel, "show", press_once)
        return panel

    monkeypatch.setattr("fmp_drake.apps.teach.open_page", open_and_press)
    result = command("teach", "--duration", 0.2, "--out", outputs / "a.npz")
    assert result.code == 0
    assert (
        "learn: show 12 s more: learning needs at least two windows of 6 s"
        in result.out
    )
    # The page says that the program has ended, and offers no arm to drag.
    assert panels[0].shown["ended"]
    assert panels[0].shown["grab"] == ""


def test_no_button_can_be_pressed_during_an_action():
    scenario = LoadScenario("table_top")
    panel = open_page(title="teach")
    session = TeachingSession(
        scenario, MouseOnPage(panel.meshcat), panel=panel, clock=None
    )
    page = TeachPage(panel, scenario)
    page.show(session, busy="learn ...")
    assert panel.shown["mode"] == "learn ..."
    assert (panel.shown["detail"], panel.shown["progress"]) == ("", None)
    buttons = panel.shown["buttons"]
    assert set(buttons) == set(session.buttons)
    assert not any(look["enabled"] for look in buttons.values())
    page.show(session)
    assert panel.shown["buttons"]["save"]["hint"]
    panel.close()


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--scenario", "billiards"), "table_top"),
        (("--duration", -1), "duration is -1"),
        (("--out", "missing/a.npz"), "there is no folder"),
        (("--skill", "missing/b.npz"), "there is no folder"),
    ],
)
def test_impossible_requests_are_refused_in_one_line(refused, options, reason):
    assert reason in refused("teach", *options)


class Mouse:
    """A person with a mouse."""

    size, has_touch, extent = (1000, 600), False, (50, 18)

    def __init__(self, page):
        self.page = page

    def grab(self):
        return self.page.grab("drake", "bodies", "eraser", "eraser")

    def move(self, x, y):
        self.page.mouse("moved", x, y, modifiers=CTRL)

    def release(self, x, y):
        self.page.mouse("released", x, y, modifiers=CTRL)

    def press(self, x, y):
        self.page.click(x, y)


class Finger(Mouse):
    """A person with a phone, who has neither Ctrl nor a cursor."""

    size, has_touch, extent = (390, 844), True, (40, 15)

    def grab(self):
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            at = self.page.centre("drake", "bodies", "eraser", "eraser")
            self.page.touch("Start", *at)
            if "/eraser" in (self.page.run("mouseDrag.path") or ""):
                return at
            self.page.touch("End")
            time.sleep(0.5)
        raise TimeoutError("the eraser cannot be grabbed with a finger")

    def move(self, x, y):
        self.page.touch("Move", x, y)

    def release(self, *_):
        self.page.touch("End")

    def press(self, x, y):
        self.page.tap(x, y)


@pytest.mark.browser
@needs_chromium
@pytest.mark.parametrize("person", [Mouse, Finger])
def test_arm_taught_by_dragging_wipes_after_learning(tmp_path, person):
    scenario = LoadScenario("table_top")
    scenario.skill.window, scenario.skill.candidates = 2.0, 4
    panel = open_page(title="teach")
    session = TeachingSession(
        scenario,
        MouseOnPage(panel.meshcat),
        panel=panel,
        clock=None,
        out=tmp_path / "shown.npz",
        skill_file=tmp_path / "skill.npz",
    )
    buttons = TeachPage(panel, scenario)
    buttons.show(session)
    session.advance(1.0)

    def press(name):
        """Press a button until the page reacts: a changing page moves the button."""
        page.wait_for(f"document.querySelector('[data-name={name}]:enabled') !== null")
        deadline = time.monotonic() + 60
        pressed = None
        while pressed is None:
            assert time.monotonic() < deadline, f"{name} cannot be pressed"
            hand.press(*page.wait_for(MIDDLE % name))
            patience = time.monotonic() + 5
            while pressed is None and time.monotonic() < patience:
                pressed = buttons.press_clicked_button(session)
                time.sleep(0.05)
        assert pressed == name

    with Page(
        panel.url, tmp_path, size=person.size, has_touch=person.has_touch
    ) as page:
        hand = person(page)
        page.wait_for_meshcat()
        learn = page.wait_for(
            "(b => b && [b.disabled, b.textContent])"
            "(document.querySelector('[data-name=learn]'))"
        )
        assert learn == [True, "learn"]
        at = hand.grab()
        grasp = page.run("document.getElementById('fmp-grasp').textContent")
        assert grasp == "you are guiding the eraser" or person is Mouse
        # In software a picture takes a second, in which the page sends no message.
        page.run(STUB)
        session.advance(0.05)
        for i in range(100):
            t = i / 20
            way = (1 - np.exp(-2 * t)) * np.sin([0.5 * np.pi * t, np.pi * t])
            hand.move(*(at + way * person.extent))
            session.advance(0.05)
        assert session.is_guided
        hand.release(*at)
        session.advance(0.2)
        assert not session.is_guided
        page.run(DRAW)
        (demonstration,) = session.demonstrations
        low, high = demonstration.values.min(axis=0), demonstration.values.max(axis=0)
        assert np.all((high - low)[:2] > 0.08)
        assert high[2] < 0.02
        buttons.show(session)
        press("learn")
        assert session.mode == "play"
        session.advance(2.0)
        buttons.show(session)
        page.wait_for("document.body.innerText.includes('cleaned')")
        press("save")
        press("teach")
        assert session.mode == "teach"
    panel.close()
    assert len(Demonstration.load(tmp_path / "shown.npz").time) == len(
        demonstration.time
    )
    assert load_skill(tmp_path / "skill.npz").n_windows_ > 2


@pytest.mark.browser
@needs_chromium
@pytest.mark.parametrize("has_touch", [False, True])
def test_drag_with_shift_or_with_the_switch_turns_the_tool(tmp_path, has_touch):
    scenario = LoadScenario("stir")
    panel = open_page(title="teach")
    session = TeachingSession(
        scenario, MouseOnPage(panel.meshcat), panel=panel, clock=None
    )
    buttons = TeachPage(panel, scenario)
    buttons.show(session)
    session.advance(0.5)

    def is_turning():
        return panel.meshcat.GetSliderValue(TURN_SWITCH) > 0.5

    def wait_until(condition):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.1)

    size = Finger.size if has_touch else Mouse.size
    with Page(panel.url, tmp_path, size=size, has_touch=has_touch) as page:
        page.wait_for_scene(panel.meshcat)
        switch = "[data-name='turn the tool'] input"
        page.wait_for(f'document.querySelector("{switch}") !== null')
        at = np.array(page.centre("drake", "bodies", "spoon", "spoon"))
        at[1] -= 10  # On the stick.
        if has_touch:
            page.run(f'document.querySelector("{switch}").click()')
            wait_until(is_turning)
            page.touch("Start", *at)
        else:
            page.mouse("moved", *at, pressed=False, modifiers=SHIFT)
            page.mouse("pressed", *at, modifiers=SHIFT)
        assert "/spoon" in page.run("mouseDrag.path")
        grasp = page.run("document.getElementById('fmp-grasp').textContent")
        assert grasp == "you are turning the tool"
        wait_until(is_turning)
        page.run(STUB)
        session.advance(0.1)

        def move(x, y):
            if has_touch:
                page.touch("Move", x, y)
            else:
                page.mouse("moved", x, y, modifiers=SHIFT)
            session.advance(0.05)

        for i in range(30):
            way = at + np.array([i, 0])
            move(*way)
        assert session.is_guided
        buttons.show(session)
        page.wait_for("document.getElementById('fmp-mode').className === 'good'")
        # A jump of the cursor ends the drag, and the page says so.
        move(*(way - [0, 250]))
        session.advance(0.1)
        assert not session.is_guided
        buttons.show(session)
        page.wait_for(
            "document.getElementById('fmp-grasp').textContent.startsWith('not guided')"
        )
        if has_touch:
            page.touch("End")
        else:
            page.mouse("released", *way, modifiers=SHIFT)
            wait_until(lambda: not is_turning())
        session.advance(0.1)
        assert is_turning() == has_touch
        (demonstration,) = session.demonstrations
        spread = np.ptp(demonstration.values, axis=0)
        assert np.linalg.norm(spread[3:]) > 0.2
        assert np.linalg.norm(spread[:3]) < 0.05
    panel.close()
