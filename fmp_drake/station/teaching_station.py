"""The station where a person teaches the arm by hand."""

from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from fmp_drake.primitives import Demonstration
from fmp_drake.station.parts.arm_controller import AddArmController
from fmp_drake.station.parts.board_scene import AddBoardScene
from fmp_drake.station.parts.page_scene import AddBodies
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.human_hand import HumanHand
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.teaching.hand_motion import HandMotion

RATE = 20.0

# Free to move, keeping the eraser level and the elbow where it is.
GUIDING = ImpedanceConfig(
    translational_stiffness=[1e-3, 1e-3, 1e-3],
    rotational_stiffness=[30.0, 30.0, 30.0],
)


def MakeTeachingStation(
    scenario: Scenario, motion: HandMotion, *, meshcat: Meshcat | None = None
) -> Diagram:
    """Build a station where a simulated hand guides the gravity-compensated arm.

    Systems: plant, scene_graph, controller with rest for its inputs,
    gravity_compensation, actuation, human_hand, recorder, and meshcat_visualizer
    where there is a Meshcat. Output ports: position (3,) of the eraser in the board's
    frame, m, and state (14,) of the arm.
    """
    builder = DiagramBuilder()
    first, _ = motion.at(0.0)
    scene = AddBoardScene(builder, scenario, start=[*first, 0.005])
    plant = scene.plant
    controller = AddArmController(builder, scene, GUIDING)
    rest = builder.AddNamedSystem("rest", ConstantVectorSource(np.zeros(3)))
    for port in ("desired_position", "desired_velocity", "desired_acceleration"):
        builder.Connect(rest.get_output_port(), controller.GetInputPort(port))
    hand = builder.AddSystem(
        HumanHand(
            plant,
            grip=scene.tip,
            X_WB=scene.X_WB,
            motion=motion,
            R_BE=scenario.eraser_orientation(),
        )
    )
    for port in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(port), hand.GetInputPort(port))
    builder.Connect(
        hand.GetOutputPort("spatial_forces"),
        plant.GetInputPort("applied_spatial_force"),
    )
    position = hand.GetOutputPort("position")
    LogVectorOutput(position, builder, 1 / RATE).set_name("recorder")
    if meshcat is not None:
        AddBodies(builder, scene, scenario, meshcat)
    builder.ExportOutput(position, "position")
    builder.ExportOutput(plant.get_state_output_port(scene.panda), "state")
    diagram = builder.Build()
    diagram.set_name("teaching_station")
    return diagram


def DemonstrationFromRecorder(
    diagram: Diagram, context: Context, *, skip: float, note: str
) -> Demonstration:
    """Return what the recorder of a teaching station has recorded.

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
