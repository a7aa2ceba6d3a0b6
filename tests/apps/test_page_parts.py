"""Facts about the parts of the page: each is visible, and each can be left out."""

import numpy as np
import pytest
from browser import Page, needs_chromium
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.systems.page.paths import draw_demonstrations
from fmp_drake.systems.page.plan_visualizer import PlanVisualizer
from fmp_drake.systems.page.trail_visualizer import TrailVisualizer

pytestmark = [pytest.mark.browser, needs_chromium]

ANGLE = np.linspace(0, 2 * np.pi, 40)
RING = np.stack([0.2 * np.cos(ANGLE), 0.3 * np.sin(ANGLE), 0 * ANGLE], axis=1)
BOARD = "bodies/whiteboard/board"


class Round(LeafSystem):
    """A point on a circle."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("point", 3, self._calc)

    def _calc(self, context, output: BasicVector):
        t = context.get_time()
        output.SetFromVector(np.array([0.2 * np.cos(t), 0.3 * np.sin(t), 0.0]))


def trail(builder, meshcat):
    point = builder.AddSystem(Round())
    visualizer = builder.AddSystem(TrailVisualizer(meshcat, path=f"{BOARD}/trail"))
    builder.Connect(point.get_output_port(), visualizer.get_input_port())


def plan(*shown):
    def add(builder, meshcat):
        shows = {
            f"show_{name}": name in shown for name in ("plan", "tube", "component")
        }
        visualizer = builder.AddSystem(
            PlanVisualizer(
                meshcat,
                points=len(RING),
                component_paths=[RING],
                path=f"{BOARD}/plan",
                **shows,
            )
        )
        covariance = np.tile(2e-4 * np.eye(3), (len(RING), 1, 1))
        for name, value in {
            "plan": RING.ravel(),
            "plan_covariance": covariance.ravel(),
            "component": np.zeros(1),
        }.items():
            source = builder.AddSystem(ConstantVectorSource(value))
            builder.Connect(source.get_output_port(), visualizer.GetInputPort(name))

    return add


def demonstrations(builder, meshcat):
    assert builder is not None
    draw_demonstrations(meshcat, f"{BOARD}/demonstrations", [RING, 0.9 * RING])


# How to add a part, what its colour is like, and how many pixels it has at least.
PARTS = {
    "trail": (trail, lambda r, g, b: (r > g + 0.15) & (g > b + 0.1), 100),
    "plan": (plan("plan"), lambda r, g, b: (g > r + 0.1) & (g > b + 0.05), 200),
    "tube": (plan("tube"), lambda r, g, b: (g > r + 0.05) & (g > b + 0.02), 2000),
    "component": (
        plan("component"),
        lambda r, g, b: (b > g + 0.03) & (b > r + 0.03),
        100,
    ),
    "demonstrations": (
        demonstrations,
        lambda r, g, b: (abs(r - b) < 0.12) & (abs(r - g) < 0.08) & (r < 0.85),
        200,
    ),
}


@pytest.fixture(scope="module")
def meshcat():
    meshcat = Meshcat(MeshcatParams(show_stats_plot=False))
    for name in ("/Grid", "/Axes"):
        meshcat.SetProperty(name, "visible", False)
    for name in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background", name, [1.0, 1.0, 1.0])
    meshcat.SetCameraPose([1.2, 0.0, 0.9], [0.5, 0.0, 0.1])
    return meshcat


@pytest.fixture(scope="module")
def page(meshcat, tmp_path_factory):
    with Page(meshcat.web_url(), tmp_path_factory.mktemp("page")) as page:
        page.wait_for_meshcat()
        yield page


def picture(page, meshcat):
    """Return the picture of the page after it has stopped changing."""
    meshcat.Flush()
    return page.settled_picture()[30:]  # Without the bar of the controls.


@pytest.mark.parametrize("name", PARTS)
def test_every_part_is_seen_on_the_board_and_only_where_it_is_added(
    page, meshcat, name
):
    add, colored, least = PARTS[name]
    meshcat.Delete("bodies")
    meshcat.SetTransform(BOARD, RigidTransform([0.5, 0.0, 0.1]))
    empty = picture(page, meshcat)
    builder = DiagramBuilder()
    add(builder, meshcat)
    if builder.GetSystems():
        Simulator(builder.Build()).AdvanceTo(3.0)
    shown = picture(page, meshcat)
    red, green, blue = np.moveaxis(shown, -1, 0)
    new = np.abs(shown - empty).max(axis=-1) > 0.03
    assert np.sum(new & colored(red, green, blue)) > least
    assert not np.any(colored(*np.moveaxis(empty, -1, 0)))
    # It moves with the board.
    meshcat.SetTransform(BOARD, RigidTransform([0.5, 0.0, 5.0]))
    gone = picture(page, meshcat)
    assert np.array_equal(gone, empty)
