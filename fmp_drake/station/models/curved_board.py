"""Contact and visual geometry of a curved board: one mesh for every surface."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    CollisionFilterDeclaration,
    GeometryId,
    GeometryInstance,
    GeometrySet,
    InMemoryMesh,
    MakePhongIllustrationProperties,
    Mesh,
    PerceptionProperties,
    ProximityProperties,
    Rgba,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from fmp_drake.station.models.model_files import Colour, linear_colour
from fmp_drake.station.scenario_parts import BoardConfig
from fmp_drake.systems.surface.surface import Surface, place, rotations

Array = NDArray[np.float64]
Faces = NDArray[np.int_]

# How deep 10 N press a felt, m, and the fraction of it by which a flat face of the mesh may
# be off the surface.
_FELT_DEPTH, _DEVIATION = 2e-3, 0.1
# A board this much narrower than a pipe's circumference is wound round it, m.
_SEAM = 1e-3


def cell_of(surface: Surface) -> tuple[float, float]:
    """Return the longest edges of a mesh along u and v, m; infinite along straight lines.

    An edge L of a circle of radius R deviates from it by L² / 8R, and the diagonal of a
    cell on a sphere by that of both of its edges.
    """
    allowed = 8 * _DEVIATION * _FELT_DEPTH / max(int(np.count_nonzero(surface)), 1)
    u, v = (math.sqrt(allowed / abs(k)) if k else math.inf for k in surface)
    return u, v


def curved_slab(
    surface: Surface,
    size: tuple[float, float],
    thickness: float,
) -> tuple[Array, Array, Faces]:
    """Return the mesh of a slab below a surface.

    Parameters
    ----------
    surface : Surface
    size : tuple of 2 floats
        Along u and v, m.
    thickness : float
        m; less than the radius of the surface.

    Returns
    -------
    vertices : array, shape (N, 3)
        In S, m.
    normals : array, shape (N, 3)
        Out of the slab, for shading.
    faces : array of int, shape (M, 3)
        Counterclockwise seen from outside.
    """
    nu, nv = (
        max(1, math.ceil(edge / longest))
        for edge, longest in zip(size, cell_of(surface), strict=True)
    )
    u, v = (
        np.linspace(-a / 2, a / 2, n + 1) for a, n in zip(size, (nu, nv), strict=True)
    )
    uvh = np.zeros((2, nu + 1, nv + 1, 3))
    uvh[..., 0], uvh[..., 1] = u[:, None], v
    uvh[1, ..., 2] = -thickness
    index = np.arange(uvh[..., 0].size).reshape(uvh.shape[:3])
    top, bottom = index
    quads = [_quads(top), _quads(bottom)[:, ::-1]]
    wound = [
        a > length - _SEAM
        for a, length in zip(size, surface.circumference, strict=True)
    ]
    if not wound[0]:
        quads += [_quads(index[::-1, 0]), _quads(index[:, -1])]
    if not wound[1]:
        quads += [_quads(index[:, :, 0]), _quads(index[::-1, :, -1])]
    a, b, c, d = np.concatenate(quads).T
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    points = uvh.reshape(-1, 3)
    normals = rotations(surface, points)[:, :, 2]
    normals[len(normals) // 2 :] *= -1
    return place(surface, points), normals, faces


def _quads(index: Faces) -> Faces:
    """Return the quads of a grid of vertices, shape (N, 4)."""
    corners = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    return np.column_stack([corner.ravel() for corner in corners])


def AddCurvedContact(
    plant: MultibodyPlant,
    whiteboard: ModelInstanceIndex,
    config: BoardConfig,
    *,
    thickness: float,
    colour: Colour,
) -> None:
    """Add a curved slab to the body `board`, for contact and for the eye.

    It is rigid: a felt is soft enough for both.

    Parameters
    ----------
    plant : MultibodyPlant
        Registered with a SceneGraph.
    whiteboard : ModelInstanceIndex
    config : BoardConfig
        Of a curved shape.
    thickness : float
        m; at most half of the radius is taken.
    colour : tuple of 3 floats
        sRGB.
    """
    x, y = config.size
    vertices, normals, faces = curved_slab(
        config.curvature(), (x, y), min(thickness, config.radius / 2)
    )
    text = _obj(vertices, normals, faces)
    shape = Mesh(InMemoryMesh(mesh_file=MemoryFile(text, ".obj", "slab")))
    body: Any = plant.GetBodyByName("board", whiteboard)
    contact = ProximityProperties()
    AddRigidHydroelasticProperties(contact)
    rough = CoulombFriction(config.friction, config.friction)
    AddContactMaterial(friction=rough, properties=contact)
    plant.RegisterCollisionGeometry(body, RigidTransform(), shape, "slab", contact)
    visual = GeometryInstance(RigidTransform(), shape, "slab")
    visual.set_illustration_properties(
        MakePhongIllustrationProperties(np.array([*colour, 1.0]))
    )
    plant.RegisterVisualGeometry(body, visual)
    rendered = GeometryInstance(RigidTransform(), shape, "slab_rendered")
    material = PerceptionProperties()
    material.AddProperty("phong", "diffuse", Rgba(*linear_colour(colour)))
    rendered.set_perception_properties(material)
    plant.RegisterVisualGeometry(body, rendered)


def _obj(vertices: Array, normals: Array, faces: Faces) -> str:
    """Return a mesh as Wavefront OBJ."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in normals]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"


def FilterHull(
    plant: MultibodyPlant, scene_graph: SceneGraph, whiteboard: ModelInstanceIndex
) -> None:
    """Exclude contact without hydroelastic shapes for a board whose hull is not its surface.

    Everything else touches a mesh as its convex hull: over a bowl that is an invisible lid.
    The `SurfaceMonitor` reports hard bodies there.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized.
    scene_graph : SceneGraph
    whiteboard : ModelInstanceIndex
    """
    inspector = scene_graph.model_inspector()
    ids = inspector.GetAllGeometryIds(Role.kProximity)
    board = plant.GetBodyFrameIdOrThrow(
        plant.GetBodyByName("board", whiteboard).index()
    )
    slab = [g for g in ids if inspector.GetFrameId(g) == board]
    others = [g for g in ids if not _is_hydroelastic(inspector, g)]
    scene_graph.collision_filter_manager().Apply(
        CollisionFilterDeclaration().ExcludeBetween(
            GeometrySet(slab), GeometrySet(others)
        )
    )


def _is_hydroelastic(inspector: Any, geometry: GeometryId) -> bool:
    properties = inspector.GetProximityProperties(geometry)
    return bool(properties.HasProperty("hydroelastic", "compliance_type"))
