"""Facts about the page in a browser, running and replayed."""

import socket
import subprocess
import sys
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser import CTRL, OFFLINE, PANEL, Page, needs_chromium

from fmp_drake.apps import wipe as wipe_module
from fmp_drake.apps.page import open_page
from fmp_drake.errors import FmpError
from fmp_drake.runs.station_run import WipingRun
from fmp_drake.skills.learning import default_demonstration, learn_skill
from fmp_drake.skills.loading import load_on_board
from fmp_drake.station.scenario import LoadScenario

# Share of the picture that is inked board.
INKED = 0.02

pytestmark = [pytest.mark.browser, needs_chromium]


def blue_ink(picture):
    r, _, b = np.moveaxis(picture, -1, 0)
    return (b > 0.4) & (b - r > 0.12) & (r > 0.14)  # In the arm's shadow, too.


def white(picture):
    return picture.min(axis=-1) > 0.85


def wiped_patch(picture):
    """Return the white pixels with ink in all four directions."""
    ink = blue_ink(picture)
    inside = white(picture)
    for axis in (0, 1):
        for flip in (False, True):
            view = np.flip(ink, axis) if flip else ink
            before = np.maximum.accumulate(view, axis=axis)
            inside &= np.flip(before, axis) if flip else before
    return inside


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Browser that opens one page after another."""
    with Page("about:blank", tmp_path_factory.mktemp("page")) as page:
        yield page


def opened(browser, url):
    """Open the page of a run."""
    browser.go(url)
    browser.wait_for_meshcat()
    return browser


def settled(page, when):
    """Return the text of a page when a condition holds, or after a time limit."""
    for _ in range(20):
        picture = page.settled_picture()
        if when(picture):
            break
    return picture


def has_ink(picture):
    return np.mean(blue_ink(picture)) > INKED


def assert_shows_a_wiped_board(picture):
    assert np.mean(blue_ink(picture)) > INKED
    assert np.mean(wiped_patch(picture)) > 0.001
    # The frame of the board and the arm's joints and base.
    assert np.mean(picture.max(axis=-1) < 0.3) > 0.002


def orange(picture):
    r, g, b = np.moveaxis(picture, -1, 0)
    return (r > 0.5) & (r > 1.3 * g) & (g > 1.5 * b) & (g > 0.2)


def green(picture):
    r, g, b = np.moveaxis(picture, -1, 0)
    return (g > r + 0.15) & (g > b + 0.1)


@pytest.fixture(scope="module")
def learned():
    scenario = LoadScenario("table_top")
    demonstrations, *_ = load_on_board(
        [default_demonstration()], scenario=scenario, transform=None, stretch=1.0
    )
    return demonstrations, learn_skill(demonstrations, window=6.0, n_components=10)


@pytest.fixture(scope="module")
def panel():
    return open_page()


@pytest.fixture(scope="module")
def meshcat(panel):
    return panel.meshcat


def make_run(learned, panel, *, show=None):
    demonstrations, skill = learned
    scenario = LoadScenario("table_top")
    for name in vars(scenario.show):
        setattr(scenario.show, name, show is None or name in show)
    return WipingRun(
        scenario,
        skill,
        demonstrations=demonstrations,
        sample=True,
        meshcat=panel.meshcat,
        panel=panel,
    )


@pytest.fixture(scope="module")
def run(learned, panel):
    """Simulate three seconds of `fmp-drake wipe`."""
    run = make_run(learned, panel)
    run.advance_to(3.0)
    return run


@pytest.fixture(scope="module")
def pictures(run, meshcat, browser):
    """Pictures of the running page with and without arm and board."""
    assert run.output("cleaned_fraction")[0] > 0.01
    page = opened(browser, meshcat.web_url())
    picture = settled(page, has_ink)
    meshcat.SetProperty("/drake/bodies", "visible", False)
    meshcat.Flush()
    bare = settled(page, lambda bare: not np.array_equal(bare, picture))
    meshcat.SetProperty("/drake/bodies", "visible", True)
    return picture, bare


def test_running_page_shows_arm_board_and_wiped_ink(pictures):
    picture, bare = pictures
    assert_shows_a_wiped_board(picture)
    # The arm and the board are what Drake's visualizer shows.
    gone = np.abs(picture - bare).max(axis=-1) > 0.1
    assert np.mean(gone) > 0.01
    # Above the board, where only the arm is.
    first_ink = np.argmax(blue_ink(picture).any(axis=1))
    assert np.mean(gone[:first_ink]) > 0.01


def test_running_page_shows_trail_and_plan(pictures):
    picture, _ = pictures
    assert np.sum(orange(picture)) > 20
    assert np.sum(green(picture)) > 100


def test_everything_but_the_bodies_can_be_switched_off(learned, browser):
    panel = open_page()
    run = make_run(learned, panel, show=())
    run.advance_to(1.0)
    assert panel.meshcat.GetSliderNames() == []
    assert panel.shown["legend"] == []
    picture = opened(browser, panel.meshcat.web_url()).settled_picture()
    for part in (orange, green, blue_ink):
        assert np.mean(part(picture)) < 1e-3
    assert np.mean(picture.max(axis=-1) < 0.3) > 0.002


def test_a_drag_in_the_page_pulls_the_wiping_arm_off_its_path(run, panel, browser):
    simulator = run.simulator

    def error():
        return np.linalg.norm(
            run.output("desired_position") - run.output("measured_position")
        )

    def step_until(condition):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, f"the error is {error()} m"
            simulator.AdvanceTo(simulator.get_context().get_time() + 0.02)
            time.sleep(0.01)

    uninterrupted = error()
    assert uninterrupted < 0.01
    page = opened(browser, panel.url)
    at = page.grab("drake", "bodies", "eraser", "eraser")
    to = [at[0] + 150, at[1] - 50]
    page.drag(at, to, modifiers=CTRL)
    step_until(lambda: error() > 0.02)
    page.mouse("released", *to, modifiers=CTRL)
    step_until(lambda: error() < 0.01)


def test_replay_page_needs_no_network(command, tmp_path):
    html = tmp_path / "run.html"
    assert command("wipe", "--headless", "--duration", 2, "--html", html).code == 0
    size = (800 + PANEL, 500)
    with Page(html.as_uri(), tmp_path, *OFFLINE, size=size) as page:
        picture = settled(page, lambda picture: np.mean(wiped_patch(picture)) > 0.001)
        assert page.run("document.title") == "table_top"
    assert_shows_a_wiped_board(picture[:, PANEL:])


def test_page_is_for_this_machine_only_unless_it_is_opened():
    for options, is_refused in (({}, True), ({"host": "0.0.0.0"}, False)):
        panel = open_page(**options)
        # An address of this machine, but not that of localhost.
        for port, refused in (
            (urlsplit(panel.url).port, is_refused),
            (panel.meshcat.port(), True),
        ):
            with socket.socket() as visitor:
                assert (visitor.connect_ex(("127.0.0.2", port)) > 0) == refused


def test_page_at_an_address_of_another_machine_is_refused():
    with pytest.raises(FmpError, match=r"192\.0\.2\.1; give one of this machine's"):
        open_page(host="192.0.2.1")


SAYS_WHAT_PYTHON_LOGS = """
import logging, urllib.error, urllib.request
from fmp_drake.apps.page import open_page
panel, said = open_page(), []
make = logging.getLogRecordFactory()
logging.setLogRecordFactory(lambda *given: said.append(given) or make(*given))
try:
    urllib.request.urlopen(panel.meshcat.web_url() + "/nothing")
except urllib.error.HTTPError as error:
    print(error.code, said)
"""


def test_wrong_address_runs_no_python_in_a_thread_of_meshcat():
    done = subprocess.run(
        [sys.executable, "-c", SAYS_WHAT_PYTHON_LOGS],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout == "404 []\n"
    assert "/nothing" in done.stderr


@pytest.fixture
def pages(monkeypatch):
    """The pages that `fmp-drake wipe` has opened."""
    kept = []

    def open_and_keep(console=None, **options):
        kept.append(open_page(console, **options))
        return kept[-1]

    monkeypatch.setattr(wipe_module, "open_page", open_and_keep)
    return kept


def test_arm_and_board_are_on_the_page_before_anything_is_learned(
    refused, monkeypatch, pages
):
    def learn(*_args, **_options):
        (page,) = pages
        assert page.meshcat.HasPath("bodies/panda/panda_link7")
        assert page.meshcat.HasPath("bodies/whiteboard")
        assert page.shown["mode"] == "getting ready"
        raise FmpError("seen")

    monkeypatch.setattr(wipe_module, "scenario_skill", learn)
    assert "seen" in refused("wipe")


def test_command_opens_the_page_that_it_names(command, pages, browser):
    result = command("wipe", "--target-realtime-rate", 0, "--duration", 1)
    assert result.code == 0
    (page,) = pages
    assert f"watch it at {page.url}" in result.out
    picture = settled(opened(browser, page.url), has_ink)
    assert browser.run("document.title") == "table_top"
    assert "finished" in browser.run("document.body.innerText")
    assert np.mean(blue_ink(picture)) > INKED
    # The eraser has not landed yet.
    assert np.mean(wiped_patch(picture)) < 0.0003
