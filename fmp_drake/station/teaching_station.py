"""The station where a person teaches the arm by hand."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from fmp_drake.primitives import Demonstration
from fmp_drake.station.parts.arm_controller import AddArmController
from fmp_drake.station.parts.board_scene import AddBoardScene
from fmp_drake.station.parts.hands import TeachingHand
from fmp_drake.station.parts.page_scene import AddBodies
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.impedance.config import ImpedanceConfig

RATE = 20.0

# Free to move, keeping the eraser level and the elbow where it is.
GUIDING = ImpedanceConfig(
    translational_stiffness=[1e-3, 1e-3, 1e-3],
    rotational_stiffness=[30.0, 30.0, 30.0],
)


def MakeTeachingStation(
    scenario: Scenario,
    hand: TeachingHand,
    *,
    q: ArrayLike | None = None,
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Build a station where a hand leads the gravity-compensated arm.

    Systems: plant, scene_graph, controller with rest for its inputs,
    panda_driver, recorder, and meshcat_visualizer where there is a Meshcat; human_hand and leading of a
    `SimulatedHand`, mouse_hand and meshcat_mouse_spring of a `MouseOnPage`. Output ports:
    position (3,) of the eraser in the frame of the board, as the arm measures it, m; leading (1,), 1
    while the hand leads; state (14,) of the arm; torque (7,) commanded without gravity
    and actuation (7,) with it, Nm.

    Parameters
    ----------
    scenario : Scenario
    hand : TeachingHand
        For example a `SimulatedHand`, or a `MouseOnPage`.
    q : array_like, shape (7,), optional
        Joint angles in which the arm begins, rad; where the hand begins if None.
    meshcat : Meshcat, optional
        Where to show the scene.
    """
    builder = DiagramBuilder()
    start = scenario.start if hand.start is None else hand.start
    scene = AddBoardScene(builder, scenario, start=start, q=q)
    plant = scene.plant
    controller = AddArmController(builder, scene, GUIDING)
    rest = builder.AddNamedSystem("rest", ConstantVectorSource(np.zeros(3)))
    for port in ("desired_position", "desired_velocity", "desired_acceleration"):
        builder.Connect(rest.get_output_port(), controller.GetInputPort(port))
    forces, leading = hand.AddTo(builder, scene, scenario)
    builder.Connect(forces, plant.GetInputPort("applied_spatial_force"))
    position = controller.GetOutputPort("measured_position")
    LogVectorOutput(position, builder, 1 / RATE).set_name("recorder")
    if meshcat is not None:
        AddBodies(builder, scene.scene_graph, scenario, meshcat)
    builder.ExportOutput(position, "position")
    builder.ExportOutput(leading, "leading")
    builder.ExportOutput(plant.get_state_output_port(scene.panda), "state")
    builder.ExportOutput(controller.GetOutputPort("torque"), "torque")
    driver = builder.GetSubsystemByName("panda_driver")
    builder.ExportOutput(driver.GetOutputPort("torque_measured"), "actuation")
    diagram = builder.Build()
    diagram.set_name("teaching_station")
    return diagram


def DemonstrationFromRecorder(
    diagram: Diagram, context: Context, *, skip: float, note: str
) -> Demonstration:
    """Return all that the recorder of a teaching station has recorded, led or not.

    Parameters
    ----------
    diagram : Diagram
        From `MakeTeachingStation`.
    context : Context
        Of the diagram, after a simulation.
    skip : float
        Seconds to leave out at the beginning.
    note : str
    """
    recorder: Any = diagram.GetSubsystemByName("recorder")
    log = recorder.FindLog(context)
    times = log.sample_times()
    keep = times >= skip - 1e-9
    return Demonstration(
        time=np.round(times[keep] - skip, 9),
        values=np.array(log.data()[:, keep].T),
        channels=("x", "y", "z"),
        units=("m", "m", "m"),
        frame="board",
        note=note,
    )
