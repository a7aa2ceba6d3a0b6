"""The monitor of a board's surface, added to a scene."""

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Role
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder

from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.systems.impedance.status import STATUS_SIZE
from fmp_drake.systems.surface_monitor import SurfaceMonitor

_SOFT = "eraser::felt"
_ROUND = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)


def AddSurfaceWatch(
    builder: DiagramBuilder, scene: BoardScene, size: list[float], *, status: OutputPort
) -> OutputPort:
    """Watch all of arm and eraser that touches and is hard; report it in the status.

    Systems: surface_monitor; status, the sum of the controller's status and the
    monitor's. Output ports: penetration, status.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
    size : list of 2 floats
        The board's, m.
    status : OutputPort
        The controller's.

    Returns
    -------
    OutputPort
        The sum.
    """
    plant = scene.plant
    inspector = scene.scene_graph.model_inspector()
    bodies, points, radii = [], [], []
    for g in inspector.GetAllGeometryIds(Role.kProximity):
        body: Any = plant.GetBodyFromFrameId(inspector.GetFrameId(g))
        own = body.model_instance() == scene.whiteboard
        if own or inspector.GetName(g) == _SOFT:
            continue
        centres, radius = _balls(inspector.GetShape(g))
        X_BodyG = inspector.GetPoseInFrame(g)
        R_BodyG = X_BodyG.rotation().matrix()
        points.append(centres @ R_BodyG.T + X_BodyG.translation())
        bodies += [int(body.index())] * len(centres)
        radii += [radius] * len(centres)
    monitor = builder.AddSystem(
        SurfaceMonitor(
            surface=scene.surface,
            size=size,
            bodies=bodies,
            points=np.vstack(points),
            radii=radii,
        )
    )
    builder.Connect(
        plant.get_body_poses_output_port(), monitor.GetInputPort("body_poses")
    )
    total = builder.AddNamedSystem("status", Adder(2, STATUS_SIZE))
    builder.Connect(status, total.get_input_port(0))
    builder.Connect(monitor.GetOutputPort("status"), total.get_input_port(1))
    builder.ExportOutput(total.get_output_port(), "status")
    builder.ExportOutput(monitor.GetOutputPort("penetration"), "penetration")
    return total.get_output_port()


def _balls(shape: Any) -> tuple[NDArray[np.float64], float]:
    """Return centres, shape (N, 3), and radius of balls on a shape's outside, m."""
    ends = (-0.5, 0.0, 0.5)
    if isinstance(shape, Box):
        return np.array(list(product(ends, ends, ends))) * shape.size(), 0.0
    if isinstance(shape, Capsule):
        return np.array(
            [[0.0, 0.0, end * shape.length()] for end in ends]
        ), shape.radius()
    r, length = shape.radius(), shape.length()
    rims = product(_ROUND, ends)
    return np.array([[r * np.cos(a), r * np.sin(a), e * length] for a, e in rims]), 0.0
