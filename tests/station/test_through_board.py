"""Facts about what is hard: nothing goes through the board at any force of a person."""

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.errors import StationError
from fmp_drake.station import AddBoardScene, LoadScenario, MakeWipingStation, Scenario
from fmp_drake.station.tasks.wiping import AddSurfaceMonitor
from fmp_drake.systems import ImpedanceStatus, StatusFlag
from fmp_drake.systems.scripted_disturbances import Disturbance


def pushed(skill, *, felt=1.25e4, press=10.0, force=0.0, hard=True):
    """Return depth of what is hard and all flags after the eraser was pushed for 1 s."""
    scenario = LoadScenario("table_top")
    scenario.eraser.modulus = felt
    scenario.start = [0.0, 0.0, 0.005]
    push = Disturbance(start=0.2, duration=1.0, force=[0.0, 0.0, -force])
    scenario.disturbances = [push] if force else []
    station = MakeWipingStation(scenario, skill)
    if not hard:
        graph = station.GetSubsystemByName("scene_graph")
        source = station.GetSubsystemByName("plant").get_source_id()
        inspector = graph.model_inspector()
        for g in inspector.GetAllGeometryIds(Role.kProximity):
            if inspector.GetName(g) not in ("eraser::felt", "whiteboard::slab"):
                graph.RemoveRole(source, g, Role.kProximity)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    desired_force = station.GetSubsystemByName("desired_normal_force")
    at = desired_force.GetMyMutableContextFromRoot(context)
    desired_force.get_mutable_source_value(at).SetFromVector([press])
    depth, flags = 0.0, StatusFlag(0)
    for tick in range(1, 131):
        simulator.AdvanceTo(0.01 * tick)
        value = station.GetOutputPort("penetration").Eval(context)
        depth = max(depth, value[0])
        status = station.GetOutputPort("status").Eval(context)
        flags |= ImpedanceStatus.from_vector(status).flags
    return depth, flags


@pytest.mark.parametrize(
    "load", [{"force": 34.0}, {"press": 60.0, "force": 30.0, "felt": 3e3}]
)
def test_hard_parts_stay_above_the_board(bundled_skill, load):
    depth, flags = pushed(bundled_skill, **load)
    assert depth < 0.002
    assert StatusFlag.BELOW_SURFACE not in flags


def test_without_hard_parts_the_eraser_passes_through_and_the_status_reports_it(
    bundled_skill,
):
    depth, flags = pushed(bundled_skill, force=34.0, hard=False)
    assert depth > 0.02
    assert StatusFlag.BELOW_SURFACE in flags


def test_an_arm_that_falls_on_the_board_stays_above_it():
    builder = DiagramBuilder()
    scene = AddBoardScene(builder, Scenario(), start=[0.0, 0.0, 0.2])
    # What its weight does at the start; the simulated arm is without.
    weight = np.array([0.0, 32.0, 0.0, -17.0, 0.0, -2.0, 0.0])
    constant = (np.zeros(6), weight)
    sources = [builder.AddSystem(ConstantVectorSource(value)) for value in constant]
    status, torque = (source.get_output_port() for source in sources)
    AddSurfaceMonitor(builder, scene, status)
    builder.Connect(torque, scene.plant.get_actuation_input_port(scene.robot.arm))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    plant, context = scene.plant, simulator.get_context()
    touched_bodies, said = set(), 0
    for tick in range(1, 121):
        simulator.AdvanceTo(0.01 * tick)
        assert diagram.GetOutputPort("penetration").Eval(context)[0] < 0.01
        results = plant.get_contact_results_output_port().Eval(
            plant.GetMyContextFromRoot(context)
        )
        for i in range(results.num_point_pair_contacts()):
            pair = results.point_pair_contact_info(i)
            both = pair.bodyA_index(), pair.bodyB_index()
            names = {plant.get_body(body).name() for body in both}
            if "board" in names and "eraser" not in names:
                touched_bodies |= names
        said |= int(diagram.GetOutputPort("status").Eval(context)[0])
        # Seen at the next look of the monitor; a ball may be just beside.
        assert touched_bodies or not said & StatusFlag.ARM_TOUCHES
    assert {"panda_link6", "board"} <= touched_bodies
    assert said == StatusFlag.ARM_TOUCHES


# What cannot be pressed is refused.


def test_a_normal_force_that_squeezes_the_felt_flat_is_refused():
    scenario = Scenario()
    scenario.press.force = 60.0
    scenario.check()
    scenario.press.force = 61.0
    with pytest.raises(StationError, match=r"61 N; .* to its core by 60\.0 N"):
        scenario.check()


def test_a_normal_force_beyond_the_arm_s_torque_is_refused(bundled_skill):
    scenario = LoadScenario("vertical")
    scenario.eraser.modulus = 1e5
    scenario.press.force = 60.0
    with pytest.raises(
        StationError, match=r"60 N; at the start the arm can press .* 5"
    ):
        MakeWipingStation(scenario, bundled_skill)
