"""Sphere approximation of rigid collision geometry, for its distance to a board."""

from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Mesh,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array

_FELT = "eraser::felt"  # Compliant geometry, which has no spheres.
# Of the spheres at the rims of a cylinder, rad.
_RIM_ANGLES = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
# Directions in which the convex hull of a mesh has a sphere at its farthest vertex.
_SIDES = (-1.0, -0.5, 0.0, 0.5, 1.0)
_DIRECTIONS = np.array([d for d in product(_SIDES, repeat=3) if max(map(abs, d)) == 1])
# Directions of its corners, and their weights at the corners, edges and faces of a box.
_CORNERS = np.array([*product((-1.0, 1.0), repeat=3)])
_WEIGHTS = np.array(
    [np.prod(0.5 + _CORNERS * d, axis=1) for d in product((-0.5, 0.0, 0.5), repeat=3)]
)


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
    """Collect the spheres of a model: corners, rims, and five along each capsule.

    A mesh is its convex hull, as in contact, with up to 98 of its vertices, and 27 points
    between those at its corners, as in a box.

    Raises
    ------
    StationError
        Where there is no shape, or one that is none of these.
    """
    inspector = scene_graph.model_inspector()
    bodies, points, radii = [], [], []
    for g in inspector.GetAllGeometryIds(Role.kProximity):
        body: Any = plant.GetBodyFromFrameId(inspector.GetFrameId(g))
        if body.model_instance() != model or inspector.GetName(g) == _FELT:
            continue
        shape = inspector.GetShape(g)
        if not isinstance(shape, Box | Capsule | Convex | Cylinder | Mesh | Sphere):
            raise StationError(
                f"the collision geometry {inspector.GetName(g)} of {body.name()} is of "
                f"type {type(shape).__name__}; use boxes, capsules, cylinders, spheres or meshes."
            )
        centres, radius = _spheres(shape)
        X_BodyG = inspector.GetPoseInFrame(g)
        R_BodyG = X_BodyG.rotation().matrix()
        points.append(centres @ R_BodyG.T + X_BodyG.translation())
        bodies += [int(body.index())] * len(centres)
        radii += [radius] * len(centres)
    if not bodies:
        raise StationError(
            f"the robot {plant.GetModelInstanceName(model)} has no collision geometry; "
            "give its links boxes, capsules, cylinders, spheres or meshes."
        )
    return CollisionSpheres(np.array(bodies), np.vstack(points), np.array(radii))


def _spheres(shape: Any) -> tuple[Array, float]:
    """Return centres, shape (N, 3), and radius of the spheres of a shape, m."""
    ends = (-0.5, 0.0, 0.5)
    if isinstance(shape, Box):
        return np.array(list(product(ends, ends, ends))) * shape.size(), 0.0
    if isinstance(shape, Capsule):
        heights = np.linspace(-0.5, 0.5, 5)[:, None] * shape.length()
        return heights * np.array([0.0, 0.0, 1.0]), shape.radius()
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), shape.radius()
    if isinstance(shape, Convex | Mesh):
        hull = shape.GetConvexHull()
        vertices = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        farthest = np.argmax(vertices @ _DIRECTIONS.T, axis=0)
        corners = vertices[np.argmax(vertices @ _CORNERS.T, axis=0)]
        return np.vstack([vertices[np.unique(farthest)], _WEIGHTS @ corners]), 0.0
    r, length = shape.radius(), shape.length()
    rims = product(_RIM_ANGLES, ends)
    return np.array([[r * np.cos(a), r * np.sin(a), e * length] for a, e in rims]), 0.0
