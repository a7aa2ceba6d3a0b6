"""Sphere approximation of rigid collision geometry, for its distance to a board."""

from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex

from fmp_drake.station.robots.robot import MakeRobotModel, RobotConfig
from fmp_drake.systems.surface.surface import PLANE, Surface
from fmp_drake.systems.surface_monitor import along, clearances, moved

Array = NDArray[np.float64]

_SOFT = "eraser::felt"
_ROUND = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)


class CollisionSpheres(NamedTuple):
    """Spheres that approximate the rigid collision geometry of a model.

    Attributes
    ----------
    bodies : array of int, shape (N,)
        Indices in the plant.
    points : array, shape (N, 3)
        Centres of the spheres in the frames of their bodies, m.
    radii : array, shape (N,)
        m.
    """

    bodies: NDArray[np.int_]
    points: Array
    radii: Array


def CollectCollisionSpheres(
    plant: MultibodyPlant, scene_graph: SceneGraph, model: ModelInstanceIndex
) -> CollisionSpheres:
    """Collect the spheres of a model: corners, rims, and five along each capsule."""
    inspector = scene_graph.model_inspector()
    bodies, points, radii = [], [], []
    for g in inspector.GetAllGeometryIds(Role.kProximity):
        body: Any = plant.GetBodyFromFrameId(inspector.GetFrameId(g))
        if body.model_instance() != model or inspector.GetName(g) == _SOFT:
            continue
        centres, radius = _spheres(inspector.GetShape(g))
        X_BodyG = inspector.GetPoseInFrame(g)
        R_BodyG = X_BodyG.rotation().matrix()
        points.append(centres @ R_BodyG.T + X_BodyG.translation())
        bodies += [int(body.index())] * len(centres)
        radii += [radius] * len(centres)
    return CollisionSpheres(np.array(bodies), np.vstack(points), np.array(radii))


class ArmClearance:
    """Clearance of an arm's links, without its tool, from a board.

    Parameters
    ----------
    config : RobotConfig
    """

    def __init__(self, config: RobotConfig) -> None:
        self._graph = SceneGraph()
        robot = MakeRobotModel(config, scene_graph=self._graph)
        self._plant = robot.plant
        hard = CollectCollisionSpheres(robot.plant, self._graph, robot.arm)
        indices, self._owner = np.unique(hard.bodies, return_inverse=True)
        self._links = [self._plant.get_body(BodyIndex(i)) for i in indices]
        self._points, self._radii = hard.points, hard.radii
        self._context = self._plant.CreateDefaultContext()

    def nearest(
        self, q: Array, X_BW: Array, box: Array, curvature: Surface = PLANE
    ) -> tuple[Array, str]:
        """Return the distance to a board, and the nearest link.

        Parameters
        ----------
        q : array, shape (N, n)
            rad.
        X_BW : array, shape (N, 3, 4)
            The world in the frame of the board.
        box : array, shape (2, 3)
            The board's lower and upper corner in B, or in (u, v, h), m.
        curvature : Surface
            Of the board.

        Returns
        -------
        distance : array, shape (N,)
            Of the nearest link, m; negative where it would be in the board.
        link : str
            Name of the body.
        """
        X = np.empty((len(q), len(self._links), 3, 4))
        for i in range(len(q)):
            self._plant.SetPositions(self._context, q[i])
            for j, link in enumerate(self._links):
                X[i, j] = self._plant.EvalBodyPoseInWorld(
                    self._context, link
                ).GetAsMatrix34()
        p_W = moved(X[:, self._owner], self._points)
        p = along(curvature, moved(X_BW[:, None], p_W))
        distance = clearances(p, self._radii, box)
        nearest = int(np.argmin(np.min(distance, axis=0)))
        return np.min(distance, axis=1), self._links[self._owner[nearest]].name()


def _spheres(shape: Any) -> tuple[Array, float]:
    """Return centres, shape (N, 3), and radius of spheres on a shape's surface, m."""
    ends = (-0.5, 0.0, 0.5)
    if isinstance(shape, Box):
        return np.array(list(product(ends, ends, ends))) * shape.size(), 0.0
    if isinstance(shape, Capsule):
        along = np.linspace(-0.5, 0.5, 5)[:, None] * shape.length()
        return along * np.array([0.0, 0.0, 1.0]), shape.radius()
    r, length = shape.radius(), shape.length()
    rims = product(_ROUND, ends)
    return np.array([[r * np.cos(a), r * np.sin(a), e * length] for a, e in rims]), 0.0
