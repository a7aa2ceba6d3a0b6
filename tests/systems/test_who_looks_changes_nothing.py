"""Facts about runs with viewers: they are those without, to the last bit."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource
from rubbed_board import GRID, OUTPUTS, add_ink, make_plant

from fmp_drake.systems.page.force_arrow import ForceArrow
from fmp_drake.systems.page.ink_visualizer import InkVisualizer
from fmp_drake.systems.page.page_controls import PageControls
from fmp_drake.systems.page.page_panel import PagePanel
from fmp_drake.systems.page.page_status import PageStatus
from fmp_drake.systems.page.plan_visualizer import PlanVisualizer
from fmp_drake.systems.page.trail_visualizer import TrailVisualizer

PATHS = [np.eye(4, 3)]


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


class Controlled(LeafSystem):
    """A pendulum in continuous time, damped by a controller at 1 kHz."""

    def __init__(self):
        super().__init__()
        state = self.DeclareContinuousState(BasicVector([1.0, 0.0, 0.0]))
        self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("state", state)
        self.DeclarePeriodicDiscreteUpdateEvent(0.001, 0.0, self._control)

    def _control(self, context, values):
        _, speed, _ = context.get_continuous_state_vector().CopyToVector()
        values.set_value(np.array([-0.3 * speed]))

    def DoCalcTimeDerivatives(self, context, derivatives):
        angle, speed, _ = context.get_continuous_state_vector().CopyToVector()
        (torque,) = context.get_discrete_state_vector().value()
        derivatives.get_mutable_vector().SetFromVector(
            [speed, torque - 9.81 * np.sin(angle), angle]
        )


def controlled(meshcat, *, watched):
    builder = DiagramBuilder()
    pendulum = builder.AddSystem(Controlled())
    if watched:
        trail = builder.AddSystem(TrailVisualizer(meshcat))
        builder.Connect(pendulum.get_output_port(0), trail.get_input_port())
        plan = PlanVisualizer(meshcat, points=2, component_paths=PATHS)
        builder.AddSystem(plan)
        for name, size in (("plan", 6), ("plan_covariance", 18), ("component", 1)):
            source = builder.AddSystem(ConstantVectorSource(np.zeros(size)))
            builder.Connect(source.get_output_port(), plan.GetInputPort(name))
        builder.AddSystem(PageControls(meshcat))
        status = builder.AddSystem(PageStatus(PagePanel(meshcat), area=[True]))
        for i in range(status.num_input_ports()):
            port = status.get_input_port(i)
            source = builder.AddSystem(ConstantVectorSource(np.ones(port.size())))
            builder.Connect(source.get_output_port(), port)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-6)
    return simulator


@pytest.mark.parametrize("begin", [0.0, 0.7131])
def test_the_integrator_takes_the_same_steps_with_a_page(meshcat, begin):
    states = []
    for watched in (False, True):
        simulator = controlled(meshcat, watched=watched)
        simulator.get_mutable_context().SetTime(begin)
        simulator.AdvanceTo(begin + 1.2)
        context = simulator.get_context()
        states.append(context.get_continuous_state_vector().CopyToVector())
    assert_array_equal(*states)


def wiping(meshcat=None):
    builder = DiagramBuilder()
    plant, eraser, surface = make_plant(builder)
    board = add_ink(builder, plant, eraser, surface)
    if meshcat is not None:
        shown = builder.AddSystem(InkVisualizer(meshcat=meshcat, grid=GRID))
        builder.Connect(board.GetOutputPort("ink"), shown.get_input_port())
        arrow = builder.AddSystem(ForceArrow(plant, body=eraser, meshcat=meshcat))
        builder.Connect(plant.get_contact_results_output_port(), arrow.get_input_port())
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    for name, value in (("y", 0.3), ("x", 0.1)):
        plant.GetJointByName(name).set_translation_rate(context, value)
    plant.GetJointByName("z").set_translation(context, -0.001)
    return simulator, plant, board


def outcome(simulator, plant, board):
    context = simulator.get_context()
    own = board.GetMyContextFromRoot(context)
    return [
        plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(context)),
        *(board.GetOutputPort(name).Eval(own) for name in OUTPUTS),
    ]


def test_wiping_is_the_same_with_ink_and_force_on_a_page(meshcat):
    outcomes = []
    for page in (None, meshcat):
        run = wiping(page)
        run[0].AdvanceTo(0.4)
        outcomes.append(outcome(*run))
    assert outcomes[0][1].min() < 0.1
    for one, other in zip(*outcomes, strict=True):
        assert_array_equal(one, other)


def test_a_run_with_a_page_continues_identically_from_any_instant(meshcat):
    simulator, plant, board = wiping(meshcat)
    copies = []
    for time in np.sort(np.random.default_rng(0).uniform(0.01, 0.3, 20)):
        simulator.AdvanceTo(time)
        outcome(simulator, plant, board)
        copies.append(simulator.get_context().Clone())
    simulator.AdvanceTo(0.35)
    expected = outcome(simulator, plant, board)
    for copy in copies:
        again = Simulator(simulator.get_system(), copy)
        again.AdvanceTo(0.35)
        for one, other in zip(expected, outcome(again, plant, board), strict=True):
            assert_array_equal(one, other)
