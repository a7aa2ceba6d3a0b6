"""Facts about the page of each scenario in a browser, running and replayed."""

import numpy as np
import pytest
from browser import OFFLINE, PANEL, Page, needs_chromium

from fmp_drake.apps.page import open_page
from fmp_drake.runs.station_run import MakeRun, WipingRun
from fmp_drake.skills.learning import scenario_skill
from fmp_drake.station.page import BOARD, INK
from fmp_drake.station.scenario import ListScenarios, LoadScenario

REPLAYED = "moving_board"
SECONDS = 2.0
SIZE = (480, 300)
PAUSE = "document.getElementById('fmp-pause')?.textContent"

pytestmark = [pytest.mark.browser, needs_chromium]


def blue_ink(picture):
    r, _, b = np.moveaxis(picture, -1, 0)
    return (b > 0.6) & (b - r > 0.12) & (r > 0.3)


def white(picture):
    """Return the pixels of the bare board, lighter than the background."""
    return picture.min(axis=-1) > 0.875


@pytest.fixture(scope="module")
def run_of():
    """The function that simulates two seconds of a scenario with a page, each once."""
    runs = {}

    def get(name):
        if name not in runs:
            scenario = LoadScenario(name)
            skill, demonstrations, _ = scenario_skill(scenario)
            runs[name] = MakeRun(
                scenario,
                skill,
                demonstrations=demonstrations,
                meshcat=open_page().meshcat,
                recording=name == REPLAYED,
            )
            runs[name].advance_to(SECONDS)
        return runs[name]

    return get


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with Page("about:blank", tmp_path_factory.mktemp("page"), size=SIZE) as page:
        yield page


def pictures(run, page):
    """Return pictures of the page with and without the arm."""
    arm = f"/drake/bodies/{run.scenario.robot}"
    page.go(run.meshcat.web_url())
    page.wait_for_scene(run.meshcat)
    whole = page.settled_picture()
    run.meshcat.SetProperty(arm, "visible", False)
    page.wait_for_scene(run.meshcat)
    bare = page.settled_picture()
    run.meshcat.SetProperty(arm, "visible", True)
    return whole, bare


def assert_shows_the_scene(whole, bare):
    # Ink, and within its bounds board that is bare.
    ink = blue_ink(bare)
    assert np.mean(ink) > 0.001
    rows, columns = (np.flatnonzero(ink.any(axis=axis)) for axis in (1, 0))
    board = white(bare)[rows[0] : rows[-1], columns[0] : columns[-1]]
    assert np.sum(board) > 0.0002 * ink.size
    # The pixels of the arm are mostly white, and some are dark.
    arm = np.abs(whole - bare).max(axis=-1) > 0.1
    assert np.mean(arm) > 0.01
    assert np.mean(whole[arm].min(axis=-1) > 0.6) > 0.3
    assert np.mean(whole[arm].max(axis=-1) < 0.4) > 0.02
    # The edge of the picture cuts off neither.
    edges = [part[edge] for part in (arm, ink) for edge in (0, -1)]
    edges += [part[:, edge] for part in (arm, ink) for edge in (0, -1)]
    assert not any(np.any(edge) for edge in edges)


def looks():
    """Return one scenario of each robot, camera, ink, and place and kind of board."""
    found = {}
    for name in ListScenarios():
        scenario = LoadScenario(name)
        board = scenario.board
        if board.shape == "none":
            continue
        stands = (board.translation, board.rpy, board.legs, board.motion)
        found.setdefault(
            str((scenario.robot, scenario.camera, scenario.ink, *stands)), name
        )
    return list(found.values())


@pytest.mark.parametrize("name", looks())
def test_page_shows_arm_board_and_ink_of_a_scenario(run_of, page, name):
    run = run_of(name)
    assert run.output("cleaned_fraction")[0] > 0.002
    whole, bare = pictures(run, page)
    assert_shows_the_scene(whole, bare)


def test_page_of_free_space_has_neither_ink_nor_force(run_of, page):
    run = run_of("stir")
    assert not isinstance(run, WipingRun)
    whole, bare = pictures(run, page)
    assert np.mean(blue_ink(bare)) < 0.0005
    assert np.mean(np.abs(whole - bare).max(axis=-1) > 0.1) > 0.01
    assert run.meshcat.HasPath(f"{BOARD}/plan/axes/z")
    assert not run.meshcat.HasPath("/force")


def test_recording_of_a_scenario_opens_offline_and_shows_the_same(
    run_of, page, tmp_path
):
    run = run_of(REPLAYED)
    run.remove_controls()
    html = tmp_path / "run.html"
    text = run.html()
    html.write_text(text, encoding="utf-8")
    assert '"desired_force": [' in text
    # The run's own page shows its end, without the recording.
    meshcat = run.meshcat
    for path, is_there in (
        (f"{BOARD}/plan", True),
        (f"{INK}/live", True),
        (f"{BOARD}/measured", False),
        (f"{INK}/recorded", False),
    ):
        assert meshcat.HasPath(path) == is_there
    for name in ("plan", "trail"):
        meshcat.Delete(f"{BOARD}/{name}")
    path = BOARD.strip("/").split("/")
    size = (SIZE[0] + PANEL, SIZE[1])
    with Page(html.as_uri(), tmp_path, *OFFLINE, size=size) as offline:
        offline.wait_for(f"{PAUSE} === 'play'")  # The replay has ended.
        offline.wait_for_scene()
        said = offline.run("document.body.innerText")
        assert f"{SECONDS:.1f} s" in said
        assert f"{100 * run.cleaned_by([SECONDS])[0]:.0f} %" in said
        offline.run(
            f"viewer.scene_tree.find({[*path, 'measured']}).object.visible = false;"
            "viewer.set_dirty()"
        )
        picture = offline.settled_picture()[:, PANEL:]
        offline.run("document.getElementById('fmp-again').click()")
        offline.wait_for(f"{PAUSE} === 'pause'")
        assert offline.run("viewer.animator.time") < SECONDS
    live, _ = pictures(run, page)
    ink, live_ink = blue_ink(picture), blue_ink(live)
    assert np.mean(live_ink) > 0.05
    # The board on its rail, arm and ink where the run left them.
    assert np.mean(ink != live_ink) < 0.05 * np.mean(live_ink)
    # Below the bar of the viewer's own controls, which the panel hides.
    assert np.mean(np.abs(picture - live)[30:].max(axis=-1) > 0.1) < 0.01
