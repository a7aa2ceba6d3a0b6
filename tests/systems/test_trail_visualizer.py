"""Facts about the paths that are drawn in Meshcat."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem

from fmp_drake.systems.page import trail_visualizer
from fmp_drake.systems.page.trail_visualizer import (
    TRAIL_DURATION,
    TRAIL_PERIOD,
    TrailVisualizer,
)

SPEED = np.array([0.0, 0.2, 0.1])
POINTS = round(TRAIL_DURATION / TRAIL_PERIOD)


class Travel(LeafSystem):
    """A point that travels at a constant velocity."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("point", 3, self._calc)

    def _calc(self, context, output: BasicVector):
        output.SetFromVector(SPEED * context.get_time())


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def drawn(monkeypatch):
    """Collect the paths and points of every drawing."""
    calls = []
    draw = trail_visualizer.draw_rod

    def spy(meshcat, path, points, **options):
        calls.append((path, points.copy()))
        draw(meshcat, path, points, **options)

    monkeypatch.setattr(trail_visualizer, "draw_rod", spy)
    return calls


def make_diagram(meshcat, **options):
    builder = DiagramBuilder()
    travel = builder.AddSystem(Travel())
    visualizer = builder.AddSystem(TrailVisualizer(meshcat, **options))
    builder.Connect(travel.get_output_port(), visualizer.get_input_port())
    return builder.Build(), visualizer


def trails(drawn):
    assert all(path == "trail/line" for path, _ in drawn)
    return [points for _, points in drawn]


def test_ports_have_names_and_sizes(meshcat):
    visualizer = TrailVisualizer(meshcat)
    assert visualizer.get_name() == "trail_visualizer"
    assert visualizer.num_output_ports() == 0
    assert visualizer.get_input_port().get_name() == "position"
    assert visualizer.get_input_port().size() == 3


def test_the_trail_is_the_last_seconds_of_the_input(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.AdvanceTo((POINTS + 20.5) * TRAIL_PERIOD)
    points = trails(drawn)[-1]
    # A picture shows the points before its own instant.
    times = TRAIL_PERIOD * np.arange(20, POINTS + 20)
    assert_allclose(points, np.outer(times, SPEED), atol=1e-12)


def test_a_young_trail_grows_from_the_first_point(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(4.5 * TRAIL_PERIOD)
    lengths = [len(points) for points in trails(drawn)]
    assert lengths == [2, 3, 4]
    for points in trails(drawn):
        assert np.all(np.isfinite(points))
        assert_array_equal(points[0], np.zeros(3))


def test_pictures_come_once_in_a_period(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    Simulator(diagram).AdvanceTo(9.95 * TRAIL_PERIOD)
    # The first two see one point only.
    assert len(trails(drawn)) == 8


def test_the_trail_is_under_the_path_and_leaves_its_transform_alone(meshcat):
    X_WB = RigidTransform([0.5, 0.0, 0.1])
    meshcat.SetTransform("board/trail", X_WB)
    sent = meshcat._GetPackedTransform("board/trail")
    diagram, _ = make_diagram(meshcat, path="board/trail")
    Simulator(diagram).AdvanceTo(0.5)
    assert meshcat.HasPath("board/trail/line")
    assert meshcat._GetPackedTransform("board/trail") == sent


def test_a_trail_thins_out_towards_its_old_end(meshcat, monkeypatch):
    radii = []
    monkeypatch.setattr(
        trail_visualizer,
        "draw_rod",
        lambda *_, radius, **__: radii.append(radius),
    )
    diagram, _ = make_diagram(meshcat)
    Simulator(diagram).AdvanceTo(1.5 * TRAIL_DURATION)
    assert_allclose(radii[-1], np.linspace(0.00025, 0.0025, POINTS))
    # A young trail is as thick at its new end.
    assert_allclose(radii[0][-1], 0.0025)


def test_a_tool_at_rest_is_not_drawn_again(meshcat, drawn):
    visualizer = TrailVisualizer(meshcat)
    simulator = Simulator(visualizer)
    visualizer.get_input_port().FixValue(
        simulator.get_mutable_context(), [0.1, 0.2, 0.3]
    )
    simulator.AdvanceTo(1.0)
    assert drawn == []


def test_two_interleaved_simulations_draw_the_same(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulators = [Simulator(diagram), Simulator(diagram)]
    for time in (0.0, 0.3, 0.7, 1.2):
        start = len(drawn)
        for simulator in simulators:
            simulator.AdvanceTo(time)
        half = (len(drawn) - start) // 2
        one, two = drawn[start : start + half], drawn[start + half :]
        for (path, points), (same_path, same_points) in zip(one, two, strict=True):
            assert path == same_path
            assert_array_equal(points, same_points)


def test_continued_run_shows_its_trail_at_once_and_continues_it(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.03)
    copy = Simulator(diagram, simulator.get_context().Clone())
    last = trails(drawn)[-1]
    drawn.clear()
    copy.Initialize()
    assert_array_equal(trails(drawn)[0][:-1], last)
    runs = []
    for each in (simulator, copy):
        drawn.clear()
        each.AdvanceTo(2.0)
        runs.append(trails(drawn))
    for one, two in zip(*runs, strict=True):
        assert_array_equal(one, two)


def test_drawing_leaves_the_context_alone(meshcat):
    diagram, visualizer = make_diagram(meshcat)
    context = diagram.CreateDefaultContext()
    own = visualizer.GetMyContextFromRoot(context)
    before = own.get_discrete_state_vector().CopyToVector()
    diagram.ForcedPublish(context)
    assert_array_equal(own.get_discrete_state_vector().value(), before)


def test_drawing_does_not_depend_on_caching(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    runs = []
    for caching in (True, False):
        drawn.clear()
        simulator = Simulator(diagram)
        if not caching:
            simulator.get_mutable_context().DisableCaching()
        simulator.AdvanceTo(1.0)
        runs.append([points for _, points in drawn])
    for one, two in zip(*runs, strict=True):
        assert_array_equal(one, two)


def test_a_forgotten_input_is_named(meshcat):
    simulator = Simulator(TrailVisualizer(meshcat))
    with pytest.raises((RuntimeError, ValueError), match=r"position.*trail_visualizer"):
        simulator.AdvanceTo(0.1)
