"""Facts about the paths that are drawn in Meshcat."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem

from fmp_drake.errors import StationError
from fmp_drake.systems import path_visualizer
from fmp_drake.systems.path_visualizer import PathVisualizer, draw_path

X_WB = RigidTransform(RotationMatrix.MakeXRotation(0.3), [0.5, 0.0, 0.1])
NAMES = ("desired", "measured")
SPEED = {"desired": np.array([0.1, 0.0, 0.0]), "measured": np.array([0.0, 0.2, 0.1])}


class Travel(LeafSystem):
    """Two points that travel at constant velocities."""

    def __init__(self):
        super().__init__()
        for name in NAMES:
            self.DeclareVectorOutputPort(name, 3, self._calc(SPEED[name]))

    def _calc(self, velocity):
        def calc(context, output: BasicVector):
            output.SetFromVector(velocity * context.get_time())

        return calc


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def drawn(monkeypatch):
    """Collect the paths and points of every drawing."""
    calls = []
    draw = path_visualizer.draw_path

    def spy(meshcat, path, points, **options):
        calls.append((path, points.copy()))
        draw(meshcat, path, points, **options)

    monkeypatch.setattr(path_visualizer, "draw_path", spy)
    return calls


def make_diagram(meshcat, **options):
    builder = DiagramBuilder()
    travel = builder.AddSystem(Travel())
    visualizer = builder.AddSystem(PathVisualizer(meshcat, X_WB=X_WB, **options))
    for name in NAMES:
        builder.Connect(travel.GetOutputPort(name), visualizer.GetInputPort(name))
    return builder.Build(), visualizer


def trail(drawn, name):
    return [points for path, points in drawn if path == f"paths/{name}"]


def test_ports_have_names_and_sizes(meshcat):
    visualizer = PathVisualizer(meshcat, X_WB=X_WB)
    assert visualizer.get_name() == "path_visualizer"
    assert visualizer.num_output_ports() == 0
    assert [visualizer.get_input_port(i).get_name() for i in range(2)] == list(NAMES)
    assert [visualizer.GetInputPort(name).size() for name in NAMES] == [3, 3]


@pytest.mark.parametrize("name", NAMES)
def test_the_trail_is_the_last_seconds_of_the_input(meshcat, drawn, name):
    diagram, _ = make_diagram(meshcat, seconds=1.0, rate=10.0)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.51)
    points = trail(drawn, name)[-1]
    # A picture shows what was remembered before its own instant.
    times = np.arange(1.5, 2.45, 0.1)
    assert_allclose(points, np.outer(times, SPEED[name]), atol=1e-12)


def test_a_young_trail_grows_from_the_first_point(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, seconds=2.0, rate=10.0)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.45)
    lengths = [len(points) for points in trail(drawn, "measured")]
    assert lengths == [1, 1, 2, 3, 4]
    for points in trail(drawn, "measured"):
        assert np.all(np.isfinite(points))
        assert_array_equal(points[0], np.zeros(3))


def test_pictures_come_at_the_rate(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, rate=5.0)
    Simulator(diagram).AdvanceTo(1.99)
    assert len(trail(drawn, "desired")) == 10


def test_both_paths_are_in_the_frame_of_the_board(meshcat):
    diagram, _ = make_diagram(meshcat)
    Simulator(diagram).AdvanceTo(0.5)
    assert all(meshcat.HasPath(f"paths/{name}") for name in NAMES)
    sent = np.array(meshcat._GetPackedTransform("paths"))
    assert sent.size > 0


def test_two_interleaved_simulations_draw_the_same(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, rate=10.0)
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


def test_a_second_simulation_begins_a_new_trail(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, rate=10.0)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.0)
    first = [points for _, points in drawn]
    drawn.clear()
    simulator.get_mutable_context().SetTime(0.0)
    simulator.Initialize()
    simulator.AdvanceTo(1.0)
    again = [points for _, points in drawn]
    for one, two in zip(first, again, strict=True):
        assert_array_equal(one, two)


def test_drawing_leaves_the_context_alone(meshcat):
    diagram, visualizer = make_diagram(meshcat)
    context = diagram.CreateDefaultContext()
    own = visualizer.GetMyContextFromRoot(context)
    before = [own.get_discrete_state(i).value().copy() for i in range(2)]
    diagram.ForcedPublish(context)
    for i in range(2):
        assert_array_equal(own.get_discrete_state(i).value(), before[i])


def test_drawing_does_not_depend_on_caching(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, rate=10.0)
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


@pytest.mark.parametrize("forgotten", NAMES)
def test_a_forgotten_input_is_named(meshcat, forgotten):
    builder = DiagramBuilder()
    travel = builder.AddSystem(Travel())
    visualizer = builder.AddSystem(PathVisualizer(meshcat, X_WB=X_WB))
    (other,) = set(NAMES) - {forgotten}
    builder.Connect(travel.GetOutputPort(other), visualizer.GetInputPort(other))
    simulator = Simulator(builder.Build())
    with pytest.raises(
        (RuntimeError, ValueError), match=rf"{forgotten}.*path_visualizer"
    ):
        simulator.AdvanceTo(0.1)


@pytest.mark.parametrize(
    "options", [{"seconds": 0.0}, {"rate": -1.0}, {"rate": np.nan}]
)
def test_times_that_are_not_positive_are_refused(meshcat, options):
    with pytest.raises(StationError, match="must be positive"):
        PathVisualizer(meshcat, X_WB=X_WB, **options)


def test_one_point_is_no_path(meshcat):
    draw_path(meshcat, "alone", np.zeros((1, 3)), color=Rgba(1, 0, 0, 1))
    assert not meshcat.HasPath("alone")
    draw_path(meshcat, "pair", np.eye(2, 3), color=Rgba(1, 0, 0, 1))
    assert meshcat.HasPath("pair")
