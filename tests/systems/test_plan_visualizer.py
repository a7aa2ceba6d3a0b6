"""Facts about the plan that is drawn in Meshcat."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.systems.page import plan_visualizer
from fmp_drake.systems.page.plan_visualizer import PlanVisualizer, component_color

N = 5
SIZES = {"plan": 3 * N, "plan_covariance": 9 * N, "component": 1}
PATHS = [np.eye(4, 3) + i for i in range(7)]


class Plan(LeafSystem):
    """A plan that goes on every 0.5 s, with another component every second."""

    def __init__(self):
        super().__init__()
        calcs = {
            "plan": self.plan,
            "plan_covariance": self.covariance,
            "component": lambda t: [int(t) % len(PATHS)],
        }
        for name, size in SIZES.items():
            self.DeclareVectorOutputPort(name, size, self._calc(calcs[name]))

    @staticmethod
    def plan(time):
        steps = np.arange(N)[:, np.newaxis] + int(2 * time)
        return (steps * [0.01, 0.02, 0.0]).ravel()

    @staticmethod
    def covariance(time):
        return np.tile(1e-4 * (1 + int(2 * time)) * np.eye(3), (N, 1, 1)).ravel()

    def _calc(self, value):
        def calc(context, output: BasicVector):
            output.SetFromVector(value(context.get_time() + 1e-9))

        return calc


@pytest.fixture
def meshcat():
    return Meshcat()


@pytest.fixture
def drawn(monkeypatch):
    """Collect what is drawn: names and points; tubes with their covariances."""
    calls = []
    draw, band = plan_visualizer.draw_rod, plan_visualizer.covariance_band

    def spy_rod(meshcat, path, points, **options):
        calls.append((path.split("/")[-1], np.array(points)))
        draw(meshcat, path, points, **options)

    def spy_band(points, covariances, **options):
        calls.append(("tube", np.array(covariances)))
        return band(points, covariances, **options)

    monkeypatch.setattr(plan_visualizer, "draw_rod", spy_rod)
    monkeypatch.setattr(plan_visualizer, "covariance_band", spy_band)
    return calls


def make_diagram(meshcat, forgotten=None, **options):
    builder = DiagramBuilder()
    plan = builder.AddSystem(Plan())
    visualizer = builder.AddSystem(
        PlanVisualizer(meshcat, points=N, component_paths=PATHS, **options)
    )
    for name in SIZES:
        if name != forgotten:
            builder.Connect(plan.GetOutputPort(name), visualizer.GetInputPort(name))
    return builder.Build(), visualizer


def test_ports_have_names_and_sizes(meshcat):
    visualizer = PlanVisualizer(meshcat, points=N)
    assert visualizer.get_name() == "plan_visualizer"
    assert visualizer.num_output_ports() == 0
    ports = [visualizer.get_input_port(i) for i in range(visualizer.num_input_ports())]
    assert {port.get_name(): port.size() for port in ports} == SIZES


def test_it_draws_the_plan_its_tube_and_the_path_of_the_component(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, path="board/plan")
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.25)
    last = dict(drawn)
    assert_allclose(last["line"], Plan.plan(1.0).reshape(N, 3))
    assert_allclose(last["tube"], Plan.covariance(1.0).reshape(N, 3, 3))
    assert_array_equal(last["component"], PATHS[1])
    for name in ("line", "tube", "component"):
        assert meshcat.HasPath(f"board/plan/{name}")


def test_a_component_is_drawn_when_it_becomes_active(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.95)
    drawn.clear()
    simulator.AdvanceTo(1.96)
    assert [name for name, _ in drawn].count("component") == 1
    # It is nothing that somebody could set.
    assert meshcat.GetSliderNames() == []


@pytest.mark.parametrize("name", ["plan", "tube", "component"])
def test_every_part_can_be_switched_off(meshcat, drawn, name):
    diagram, _ = make_diagram(meshcat, **{f"show_{name}": False})
    Simulator(diagram).AdvanceTo(1.5)
    parts = {"line", "tube", "component"}
    parts.remove("line" if name == "plan" else name)
    assert {part for part, _ in drawn} == parts


def test_a_second_simulation_draws_the_same_and_begins_anew(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    runs = []
    for caching in (True, True, False):
        drawn.clear()
        simulator = Simulator(diagram)
        if not caching:
            simulator.get_mutable_context().DisableCaching()
        simulator.AdvanceTo(2.2)
        runs.append(list(drawn))
    for other in runs[1:]:
        for (name, points), (same, same_points) in zip(runs[0], other, strict=True):
            assert name == same
            assert_array_equal(points, same_points)


def test_an_initialisation_removes_what_was_drawn(meshcat):
    diagram, _ = make_diagram(meshcat, path="board/plan")
    meshcat.SetTransform("board/plan/old", np.eye(4))
    Simulator(diagram).Initialize()
    assert not meshcat.HasPath("board/plan/old")


def test_a_forced_picture_leaves_the_context_as_it_was(meshcat):
    diagram, _ = make_diagram(meshcat)
    context = diagram.CreateDefaultContext()
    before = context.get_discrete_state_vector().CopyToVector()
    diagram.ForcedPublish(context)
    assert meshcat.HasPath("plan/line")
    assert_array_equal(context.get_discrete_state_vector().CopyToVector(), before)


@pytest.mark.parametrize("forgotten", list(SIZES))
def test_a_forgotten_input_is_named(meshcat, forgotten):
    diagram, _ = make_diagram(meshcat, forgotten)
    with pytest.raises(
        (RuntimeError, ValueError), match=rf"\({forgotten}\).*plan_visualizer"
    ):
        Simulator(diagram).AdvanceTo(0.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"points": 1}, "at least 2"),
        ({"component_paths": [np.zeros((4, 2))]}, "expected .T, 3"),
    ],
)
def test_values_that_do_not_fit_are_refused(meshcat, options, message):
    with pytest.raises(SystemsError, match=message):
        PlanVisualizer(meshcat, **{"points": N, **options})


def test_neighbouring_components_have_different_colours():
    colors = np.array([component_color(i).rgba for i in range(80)])
    assert np.all(np.abs(np.diff(colors[:, :3], axis=0)).max(axis=1) > 0.15)
    assert np.all((colors >= 0) & (colors <= 1))
