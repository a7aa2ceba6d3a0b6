"""What pushes at the arm from outside, added to a scene."""

from collections.abc import Sequence

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder, OutputPort

from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import Disturbance
from fmp_drake.systems.scripted_disturbances import Grasp, Push, ScriptedDisturbances
from fmp_drake.systems.spatial_force_sum import SpatialForceSum

_PORT = "applied_spatial_force"


def AddExternalForces(
    builder: DiagramBuilder,
    scene: BoardScene,
    scenario: Scenario,
    *,
    others: Sequence[OutputPort] = (),
) -> None:
    """Export the plant's port for forces, and add the scenario's disturbances to it.

    Systems: disturbances where the scenario has any, with their sum exported as
    disturbance; spatial_force_sum where there is more than the exported port.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    scenario : Scenario
    others : sequence of OutputPort
        More forces, such as the mouse's.
    """
    sources = list(others)
    if scenario.disturbances:
        script = [_scripted(each, scene.X_WB) for each in scenario.disturbances]
        disturbances = builder.AddSystem(
            ScriptedDisturbances(grip=scene.tip, disturbances=script)
        )
        for port in ("body_poses", "body_spatial_velocities"):
            builder.Connect(
                scene.plant.GetOutputPort(port), disturbances.GetInputPort(port)
            )
        builder.ExportOutput(disturbances.GetOutputPort("force"), "disturbance")
        sources.append(disturbances.GetOutputPort("spatial_forces"))
    forces = scene.plant.GetInputPort(_PORT)
    if not sources:
        builder.ExportInput(forces, _PORT)
        return
    names = [f"source_{i}" for i in range(len(sources))]
    total = builder.AddSystem(SpatialForceSum("outside", *names))
    builder.ExportInput(total.GetInputPort("outside"), _PORT)
    for name, source in zip(names, sources, strict=True):
        builder.Connect(source, total.GetInputPort(name))
    builder.Connect(total.get_output_port(), forces)


def _scripted(each: Disturbance, X_WB: RigidTransform) -> Push:
    if each.kind == "push":
        return Push(
            start=each.start,
            duration=each.duration,
            every=each.every,
            force=X_WB.rotation() @ np.array(each.force),
        )
    return Grasp(
        start=each.start,
        duration=each.duration,
        every=each.every,
        force=np.zeros(3),
        point=X_WB @ np.array(each.position),
        stiffness=each.stiffness,
        max_force=each.max_force,
    )
