"""Facts about the panel of the page in a browser: its texts and its behaviour."""

import threading
import time

import numpy as np
import pytest
from browser import OFFLINE, Page, needs_chromium
from pydrake.systems.analysis import Simulator

from fmp_drake.apps import page as page_module
from fmp_drake.apps.page import open_page, wait_for_click
from fmp_drake.runs.simulation_loop import RunButtons
from fmp_drake.station import LoadScenario
from fmp_drake.station.page import describe_page
from fmp_drake.systems.page.page_controls import PageControls
from fmp_drake.systems.page.page_panel import add_panel

pytestmark = [pytest.mark.browser, needs_chromium]

TEXT = "document.getElementById('fmp-panel').innerText"
# Boxes of all that is written in the panel, and of what it is beside.
CUT_OFF = """(() => {
  const panel = document.getElementById('fmp-panel').getBoundingClientRect();
  const scene = viewer.renderer.domElement.getBoundingClientRect();
  const out = [...document.querySelectorAll('#fmp-panel :is(h1, p, b, span, li, button)')]
    .filter((e) => e.offsetParent && (e.scrollWidth > e.clientWidth + 1
      && getComputedStyle(e).display !== 'inline'
      || e.getBoundingClientRect().right > panel.right))
    .map((e) => e.textContent);
  return [out, scene.left - panel.right, scene.right - innerWidth];
})()"""
BUTTON = """document.querySelector('#fmp-buttons button[data-name="%s"]')"""
SLIDER = """document.querySelector('#fmp-sliders label[data-name="%s"] input')"""


@pytest.fixture(scope="module")
def panel():
    panel = open_page(title="table_top")
    panel.show(**describe_page(LoadScenario("table_top")))
    panel.show(mode="wiping", level="good", time=12.34, cleaned=0.625, force=9.5)
    yield panel
    panel.close()


@pytest.fixture(scope="module")
def page(panel, tmp_path_factory):
    with Page(panel.url, tmp_path_factory.mktemp("page")) as page:
        page.wait_for_meshcat()
        yield page


def resize(page, width, height):
    page.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=height,
        deviceScaleFactor=1,
        mobile=False,
    )
    page.wait_for(
        f"viewer.renderer.domElement.getBoundingClientRect().right == {width}"
    )


def wait_until(condition):
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.05)


def test_page_describes_the_scene_and_how_to_drag(page):
    text = page.wait_for(TEXT)
    assert page.run("document.title") == "table_top"
    for phrase in (
        *("wiping", "12.3 s", "cleaned", "63 %", "9.5 N", "5 N", "15 N"),
        *(
            "ink",
            "demonstrated paths",
            "path of the eraser",
            "plan of the next seconds",
        ),
        *("mean of the component", "force on the eraser", "Drag the arm"),
    ):
        assert phrase in text, phrase


@pytest.mark.parametrize("size", [(800, 500), (1600, 1000)])
def test_nothing_of_the_panel_is_cut_off_or_over_the_scene(page, panel, size):
    buttons = RunButtons(panel.meshcat, panel)
    with buttons:
        assert not buttons.paused
        page.wait_for(f"{BUTTON % RunButtons.RESET} !== null")
        resize(page, *size)
        assert page.run(CUT_OFF) == [[], 0, 0]


def test_long_reason_is_shown_in_full_on_a_phone(page, panel):
    resize(page, 390, 844)
    mode = "document.getElementById('fmp-mode')"
    cut_off = f"{mode}.querySelector('p').scrollHeight > {mode}.querySelector('p').clientHeight + 1"
    panel.show(mode="refused", level="bad", detail="a reason, and what to do; " * 12)
    page.wait_for(cut_off)
    hint = f"getComputedStyle({mode}, '::after').content.includes('tap to read on')"
    page.wait_for(hint)
    page.run(f"{mode}.click()")
    page.wait_for(f"!({cut_off})")
    assert not page.run(hint)
    page.run(f"{mode}.click()")
    panel.show(mode="wiping", level="good", detail="")
    resize(page, 800, 500)


def test_viewer_without_control_is_not_asked_to_drag_the_arm(panel, tmp_path):
    with Page(panel.url.split("?")[0], tmp_path) as page:
        page.wait_for_meshcat()
        text = page.wait_for(TEXT)
    assert "This page watches" in text
    assert "to turn the view" in text
    assert "Drag the arm" not in text


@pytest.mark.parametrize("size", [(390, 844), (800, 600)])
def test_no_button_of_teaching_takes_the_place_of_one_that_discards(tmp_path, size):
    panel = open_page(title="teach")
    rows = {
        "teach": ("learn", "again", "play", "save"),
        "discarded": ("learn", "again", "play", "save", "undo"),
        "play": ("slower", "teach", "more", "save"),
    }
    long = "enough to learn, and more is better; " * 5
    places = {}
    with Page(panel.url, tmp_path, size=size, has_touch=size[0] < 640) as page:
        page.wait_for_meshcat()
        for mode, names in rows.items():
            for name in names:
                panel.meshcat.AddButton(name)
            for detail, progress in (("", None), (long, 0.5)):
                panel.show(mode=mode, level="good", detail=detail, progress=progress)
                seen = f"document.querySelector('#fmp-mode b').textContent === '{mode}'"
                page.wait_for(f"{seen} && {TEXT}.includes({detail.strip()!r})")
                for name in names:
                    page.wait_for(f"{BUTTON % name} !== null")
                    box = f"{BUTTON % name}.getBoundingClientRect()"
                    place = page.run(f"[{box}.left, {box}.top, {box}.width]")
                    assert places.setdefault(name, place) == place
            for name in names:
                panel.meshcat.DeleteButton(name)
                page.wait_for(f"{BUTTON % name} === null")
    panel.close()
    assert len({tuple(places[name]) for name in ("again", "save", "undo", "more")}) == 4


@pytest.mark.parametrize("size", [(390, 844), (800, 600)])
def test_sliders_stay_where_they_are_whatever_the_page_says(tmp_path, size):
    panel = open_page(title="table_top")
    panel.show(**describe_page(LoadScenario("table_top")), mode="wiping", level="good")
    panel.show(time=12.34, cleaned=0.625, force=9.5)
    Simulator(PageControls(panel.meshcat)).Initialize()
    names = ("tempo", "press force (N)", "sample")
    places = {}
    with Page(panel.url, tmp_path, size=size, has_touch=size[0] < 640) as page:
        page.wait_for_meshcat()
        for i, detail in enumerate(("", "comes down where the movement touches")):
            panel.show(detail=detail, rate=0.5 if i else 1.0)
            if i:
                panel.say("contact lost at 6.7 s. " * 3, level="busy")
                page.wait_for(f"{TEXT}.includes('contact lost')")
                page.wait_for(f"{TEXT}.includes('this machine is slow')")
            for name in names:
                page.wait_for(f"{SLIDER % name} !== null")
            for name in names:
                box = f"{SLIDER % name}.getBoundingClientRect()"
                place = page.run(f"[{box}.left, {box}.top, {box}.width]")
                assert places.setdefault(name, place) == place
    panel.close()


@pytest.mark.parametrize("size", [(390, 844), (800, 600)])
def test_second_click_on_stop_presses_no_other_button(page, panel, size):
    resize(page, *size)
    with RunButtons(panel.meshcat, panel) as buttons:
        assert not buttons.paused
        page.wait_for(f"{BUTTON % RunButtons.STOP} !== null")
        box = f"{BUTTON % RunButtons.STOP}.getBoundingClientRect()"
        left, right, y = page.run(f"[{box}.left, {box}.right, {box}.top + 9]")
    for name in ("continue", "again"):
        panel.meshcat.AddButton(name)
    page.wait_for(f"{BUTTON % 'again'} !== null && {BUTTON % 'stop'} === null")
    for x in (left + 5, (left + right) / 2, right - 5):
        assert page.run(f"document.elementFromPoint({x}, {y}).tagName") != "BUTTON"
    for name in ("continue", "again"):
        panel.meshcat.DeleteButton(name)
    resize(page, 800, 500)


def test_reset_view_is_beside_the_menu_of_the_viewer(page):
    page.mouse("moved", 700, 450, pressed=False)
    page.mouse("pressed", 700, 450)
    page.drag([700, 450], [650, 430])
    page.mouse("released", 650, 430)
    view, menu = "document.getElementById('fmp-view')", "viewer.gui.domElement"
    page.wait_for(f"!{view}.hidden")
    for is_open in (True, False):
        page.run("document.getElementById('fmp-viewer').click()")
        page.wait_for(f"({menu}.offsetWidth > 0) === {str(is_open).lower()}")
        box = f"{view}.getBoundingClientRect()"
        if is_open:
            edge = f"{menu}.getBoundingClientRect().left"
            assert page.run(f"{box}.right <= {edge} && {box}.left > 0")
        else:
            assert page.run(f"{box}.right") == page.run("innerWidth") - 10
    page.run(f"{view}.click()")
    page.wait_for(f"{view}.hidden")


def test_a_stop_is_shown_with_its_reason_while_it_lasts(page, panel):
    panel.show(mode="protective stop", level="bad", detail="no board was found")
    page.wait_for(f"{TEXT}.includes('no board was found')")
    assert page.run("document.getElementById('fmp-mode').className") == "bad"
    panel.show(mode="wiping", level="good", detail="")
    page.wait_for(f"!{TEXT}.includes('no board was found')")


def test_pause_button_is_labelled_with_its_next_action(page, panel):
    with RunButtons(panel.meshcat, panel) as buttons:
        assert not buttons.paused
        pause = BUTTON % RunButtons.PAUSE
        page.wait_for(f"{pause} && {pause}.textContent === 'pause (P)'")
        page.run(f"{pause}.click()")
        wait_until(lambda: buttons.paused)
        page.wait_for(f"{pause}.textContent === 'resume (P)'")
        page.wait_for(f"{TEXT}.includes('paused')")
        page.run(f"{pause}.click()")
        wait_until(lambda: not buttons.paused)
        page.wait_for(f"{pause}.textContent === 'pause (P)'")
    page.wait_for(f"{pause} === null")


@pytest.mark.usefixtures("nothing_is_freed")
def test_a_program_without_a_terminal_waits_while_its_page_is_reloaded(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(page_module, "has_terminal", lambda: False)
    panel = open_page(title="table_top")
    with Page(panel.url, tmp_path) as page:
        page.wait_for_meshcat()

        # Meshcat's own functions are for the main thread only; the page is for any.
        def reload_and_click():
            page.wait_for(f"{BUTTON % 'again'} !== null")
            page.run("window.isOld = true")
            page.call("Page.reload")
            page.wait_for(f"!window.isOld && {BUTTON % 'again'} !== null")
            page.run(f"{BUTTON % 'again'}.click()")

        clicking = threading.Thread(target=reload_and_click)
        clicking.start()
        assert wait_for_click(panel, {"again": "start again"}) == "again"
        clicking.join()
    panel.close()


def test_a_button_that_is_switched_off_cannot_be_pressed(page, panel):
    panel.meshcat.AddButton("learn")
    learn = BUTTON % "learn"
    panel.show(buttons={"learn": {"label": "learn (7 s more)", "enabled": False}})
    page.wait_for(f"{learn} && {learn}.textContent === 'learn (7 s more)'")
    page.run(f"{learn}.click()")
    panel.show(buttons={})
    page.wait_for(f"!{learn}.disabled && {learn}.textContent === 'learn'")
    assert panel.meshcat.GetButtonClicks("learn") == 0
    page.run(f"{learn}.click()")
    wait_until(lambda: panel.meshcat.GetButtonClicks("learn") == 1)
    panel.meshcat.DeleteButton("learn")


def test_the_sliders_of_the_panel_are_those_of_the_diagram(page, panel):
    controls = PageControls(panel.meshcat, tempo=0.8)
    controls.ExecuteInitializationEvents(controls.CreateDefaultContext())
    tempo, samples = SLIDER % "tempo", SLIDER % "sample"
    page.wait_for(f"{tempo} && {tempo}.value === '0.8'")
    page.run(f"{tempo}.value = 1.5; {tempo}.dispatchEvent(new Event('input'))")
    wait_until(lambda: panel.meshcat.GetSliderValue("tempo") == 1.5)
    page.wait_for(f"!!{samples}")
    page.run(f"{samples}.click()")
    wait_until(lambda: panel.meshcat.GetSliderValue("sample") == 1.0)
    # And back, as an initialisation does.
    panel.meshcat.SetSliderValue("tempo", 0.5)
    page.wait_for(f"{tempo}.value === '0.5'")
    controls.Delete()
    page.wait_for(f"{tempo} === null")


def test_the_viewer_s_own_menu_is_initially_closed(page):
    menu = "viewer.gui.domElement"
    assert page.run(f"{menu}.offsetHeight") == 0
    page.run("document.getElementById('fmp-viewer').click()")
    page.wait_for(f"{menu}.offsetHeight > 0")
    assert page.run("Object.values(viewer.gui.__folders).every((f) => f.closed)")
    page.run("document.getElementById('fmp-viewer').click()")
    page.wait_for(f"{menu}.offsetHeight === 0")


def test_the_camera_of_the_page_is_known(page, panel):
    panel.meshcat.SetCameraPose([1.0, -2.0, 1.5], [0.0, 0.0, 0.0])
    page.wait_for_meshcat()

    def seen():
        X_WC = panel.meshcat.GetTrackedCameraPose()
        return X_WC is not None and np.allclose(
            X_WC.translation(), [1.0, -2.0, 1.5], atol=1e-3
        )

    wait_until(seen)


def test_page_without_its_program_reports_it(tmp_path):
    panel = open_page()
    with Page(panel.url, tmp_path) as page:
        page.wait_for_meshcat()
        panel.show(mode="wiping", level="good", **describe_page(LoadScenario("words")))
        panel.show(rate=0.5)
        panel.meshcat.AddButton("stop")
        panel.meshcat.AddSlider("tempo", 0.0, 2.0, 0.01, 1.0)
        page.wait_for(f"{TEXT}.includes('Drag the arm')")
        page.wait_for(f"{TEXT}.includes('this machine is slow')")
        page.wait_for(f"{BUTTON % 'stop'}?.disabled === false")
        page.wait_for(f"{SLIDER % 'tempo'}?.disabled === false")
        panel.close()
        page.wait_for(f"{TEXT}.includes('no connection')")
        # Controls without effect are not offered.
        page.wait_for(f"{BUTTON % 'stop'}.disabled")
        page.wait_for(f"{SLIDER % 'tempo'}.disabled")
        assert "this machine is slow" not in page.run(TEXT)
        assert "Drag the arm" not in page.run(TEXT)
        assert "to turn the view" in page.run(TEXT)


def test_a_saved_page_has_title_legend_and_explanation_without_network(panel, tmp_path):
    html = tmp_path / "run.html"
    text = describe_page(LoadScenario("words"), replay=True)
    html.write_text(
        add_panel(panel.meshcat.StaticHtml(), {**text, "title": "words"}),
        encoding="utf-8",
    )
    with Page(html.as_uri(), tmp_path, *OFFLINE) as page:
        page.wait_for("!!document.getElementById('fmp-help')?.innerText")
        content = page.run(TEXT)
        assert page.run("document.title") == "words"
        assert "Words are written on the board" in page.run(
            "document.getElementById('fmp-panel').textContent"
        )
        assert "path of the eraser" in content
        # There is no plan in a replay, and nothing to pull.
        assert "plan" not in content
        assert "Drag the arm" not in content
