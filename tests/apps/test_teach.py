"""Facts about `fmp-drake teach`, and its page in a browser."""

import time

import numpy as np
import pytest
import umsgpack
from browser import CTRL, Page, needs_chromium

from fmp_drake.apps.page import open_page
from fmp_drake.primitives import Demonstration, load_skill
from fmp_drake.runs import TeachingSession, TeachPage
from fmp_drake.station import LoadScenario, MouseOnPage

STUB = (
    "viewer.renderer.kept = viewer.renderer.render; viewer.renderer.render = () => {};"
)
DRAW = "viewer.renderer.render = viewer.renderer.kept; viewer.set_dirty();"


@pytest.mark.slow
def test_the_page_opens_and_says_where(command, outputs):
    result = command(
        *("teach", "--duration", 0.2, "--out", outputs / "a.npz"),
        *("--skill", outputs / "b.npz"),
    )
    assert result.code == 0
    assert "teach it at http://localhost:" in result.out
    assert list(outputs.iterdir()) == []


def test_what_a_button_does_is_said(command, outputs, monkeypatch):
    pressed = []

    def open_and_press(*arguments, **options):
        panel = open_page(*arguments, **options)
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
    assert "learn: show 12 s more: two windows of 6 s" in result.out


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--scenario", "billiards"), "table_top"),
        (("--duration", -1), "duration is -1"),
        (("--out", "missing/a.npz"), "there is no folder"),
        (("--skill", "missing/b.npz"), "there is no folder"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line(refused, options, reason):
    assert reason in refused("teach", *options)


@pytest.mark.browser
@needs_chromium
def test_dragged_in_the_page_learned_with_its_button_it_wipes_on(tmp_path):
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
        page.wait_for(f"document.querySelector('[data-name={name}]') !== null")
        page.run(f"document.querySelector('[data-name={name}]').click()")
        deadline = time.monotonic() + 60
        while buttons.attend(session) != name:
            assert time.monotonic() < deadline
            time.sleep(0.05)

    with Page(panel.url, tmp_path, size=(1000, 600)) as page:
        page.wait_for_meshcat()
        press("learn")
        assert session.mode == "teach"
        assert "show 4 s more" in session.remark
        at = page.grab("drake", "bodies", "eraser", "eraser")
        # In software a picture takes a second, in which the page would say nothing.
        page.run(STUB)
        session.advance(0.05)
        for i in range(100):
            t = i / 20
            way = (1 - np.exp(-2 * t)) * np.sin([0.5 * np.pi * t, np.pi * t])
            page.mouse("moved", *(at + way * [50, 18]), modifiers=CTRL)
            session.advance(0.05)
        assert session.is_led
        page.mouse("released", *at, modifiers=CTRL)
        session.advance(0.2)
        assert not session.is_led
        page.run(DRAW)
        (shown,) = session.demonstrations
        low, high = shown.values.min(axis=0), shown.values.max(axis=0)
        assert np.all((high - low)[:2] > 0.08)
        assert high[2] < 0.02
        press("learn")
        assert session.mode == "play"
        session.advance(2.0)
        buttons.show(session)
        page.wait_for("document.body.innerText.includes('cleaned')")
        press("save")
        press("teach")
        assert session.mode == "teach"
    panel.close()
    assert len(Demonstration.load(tmp_path / "shown.npz").time) == len(shown.time)
    assert load_skill(tmp_path / "skill.npz").n_windows_ > 2
