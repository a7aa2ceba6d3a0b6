"""Whiteboard of any size, flat or curved: one mesh for every curved surface."""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    GeometryId,
    GeometrySet,
    InMemoryMesh,
    Mesh,
    Role,
    SceneGraph,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, SpatialInertia, UnitInertia

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array
from fmp_drake.settings import check_settings
from fmp_drake.station.models.model_files import AddModel, Collision, Visual
from fmp_drake.station.scenario_parts import BoardConfig
from fmp_drake.systems.surface.surface import Surface, place, rotations

Faces = NDArray[np.int_]

_THICKNESS = 0.02  # Of the slab, m.
_MODULUS = 1e7  # Pressure in the middle of the slab, Pa.
_DENSITY = 500.0  # kg/m^3: 3.5 kg for a board of 0.5 m x 0.7 m.
_EDGE = 0.012  # Width of the frame, m.
_BAR_HEIGHT = 0.026  # Of the frame's bars, m.
_BAR_Z = -0.0115  # Of the middle of the frame's bars, m.
_CORNER = 0.020  # Radius of the corner caps, m.

_ORIGIN = (0.0, 0.0, 0.0)
_WHITE = (0.97, 0.97, 0.97)
_METAL = (0.70, 0.72, 0.74)
_DARK = (0.16, 0.17, 0.19)

# Compression of a felt by 10 N, m, and the largest deviation of a mesh's edge from the
# curved surface, as a fraction of it.
_COMPRESSION, _DEVIATION = 2e-3, 0.1
# Largest gap of a closed pipe: its circumference less the width of the board, m.
_SEAM = 1e-3


def AddWhiteboard(plant: MultibodyPlant, config: BoardConfig) -> ModelInstanceIndex:
    """Add the model `whiteboard`: body `board` with the frame `surface` (B).

    B has its origin at the centre of the wiping surface and z as outward normal. The
    board is a uniform slab of 20 mm. It is compliant, but much stiffer than the felt. Below
    an eraser that slides at 0.1 m/s with 10 N, the ripple of the normal force is 0.65 N peak
    to peak on a rigid slab, and 0.0001 N on this one (`lagged`, 1 ms). The bars of the
    frame, 1.5 mm above the surface, have the contact of the slab. A curved board has no
    frame, and a post instead of legs.

    Parameters
    ----------
    plant : MultibodyPlant
        Not finalized, without a model of that name.
    config : BoardConfig
        Size, friction, and whether the board has four legs of 0.1 m, for a table, or a mount
        on its back.

    Returns
    -------
    ModelInstanceIndex

    Raises
    ------
    StationError
        If a value of the config is not allowed.

    Notes
    -----
    The contact geometry of the slab is the convex hull of its corners. Drake divides it into
    12 tetrahedra around its middle, and a box into more, with slivers in contact with the
    felt. The pressure is the same. The table shows the CPU time of one core for a wiping
    table top, and the deviations of normal force and ink after 5 s from those of a step of
    0.125 ms (root mean square):

    ============================ ======= ========= ======= ======
    slab, step of the plant      plant   station   force   ink
    ============================ ======= ========= ======= ======
    hull, 1 ms (31 faces)        193 us  512 us/ms 0.049 N 0.0011
    box, 1 ms (42 faces)         281 us  662 us/ms 0.049 N 0.0011
    rigid box, 1 ms (33 faces)   206 us  558 us/ms 0.055 N 0.0010
    hull, 0.5 ms                         786 us/ms 0.040 N 0.0005
    hull, 2 ms                           348 us/ms 0.053 N 0.0028
    hull, CENIC                          504 us/ms 0.054 N 0.0016
    ============================ ======= ========= ======= ======

    With equal torques the forces of hull and box differ by 4e-7. A finer felt changes
    nothing, because a box is exact in Drake; triangles instead of polygons cost 190 us more.
    With a step of 2 ms only every second torque is applied. Links, core, handle, stem, plate
    and frame cost 10 us without contact.
    """
    check_settings(config, StationError, "board.")
    x, y = config.size
    inertia = SpatialInertia(
        _DENSITY * x * y * _THICKNESS,
        np.zeros(3),
        UnitInertia.SolidBox(x, y, _THICKNESS),
    ).Shift(np.array([0, 0, _THICKNESS / 2]))
    middle, slab = (0.0, 0.0, -_THICKNESS / 2), Box(x, y, _THICKNESS)
    parts: list[Visual | Collision] = []
    if config.curvature().is_plane:
        parts += [Visual("slab", slab, at=middle, colour=_WHITE), *_Frame(x, y)]
        parts += _FrameContacts(x, y, config.friction)
        parts += _Legs(x, y) if config.legs else _Mount(x, y)
        parts.append(_SlabContact(x, y, config.friction))
    else:
        parts += _Post(config) if config.legs else []
        parts += _CurvedSlab(config)
    return AddModel(
        plant,
        model="whiteboard",
        link="board",
        inertia=inertia,
        parts=parts,
        frames={"surface": 0.0},
    )


def BoardBox(config: BoardConfig) -> Array:
    """Return the lower and the upper corner of slab and frame, shape (2, 3), m.

    They are in B, or (u, v, h) of a curved board, see `Surface`.
    """
    if not config.curvature().is_plane:
        x, y = (edge / 2 for edge in config.size)
        return np.array([[-x, -y, -min(_THICKNESS, config.radius / 2)], [x, y, 0.0]])
    x, y = (edge / 2 + _EDGE for edge in config.size)
    return np.array(
        [[-x, -y, _BAR_Z - _BAR_HEIGHT / 2], [x, y, _BAR_Z + _BAR_HEIGHT / 2]]
    )


def _SlabContact(x: float, y: float, friction: float) -> Collision:
    """Return the contact of the slab, as the convex hull of its corners."""
    sides = ((-x / 2, x / 2), (-y / 2, y / 2), (-_THICKNESS, 0.0))
    hull = Convex(np.array(list(product(*sides))).T, "slab")
    return Collision("slab", hull, at=_ORIGIN, modulus=_MODULUS, friction=friction)


def _Frame(x: float, y: float) -> list[Visual]:
    """Return the visuals of four bars around the slab, and of caps on the corners."""
    gap = _CORNER - _EDGE  # From the slab's edge to a cap's axis.
    bars = [
        Visual(f"frame_{side}", bar, at=at, colour=_METAL)
        for side, bar, at in _Bars(x, y, length_x=x - 2 * gap, length_y=y - 2 * gap)
    ]
    cap = Cylinder(_CORNER, 0.028)
    return bars + [
        Visual(f"corner_{i}", cap, at=(*corner, _BAR_Z), colour=_DARK)
        for i, corner in enumerate(_Corners(x, y, gap), start=1)
    ]


def _FrameContacts(x: float, y: float, friction: float) -> list[Collision]:
    """Return the contact geometry of the bars; two of them include the corners."""
    bars = _Bars(x, y, length_x=x, length_y=y + 2 * _EDGE)
    return [
        Collision(f"bar_{i}", bar, at=at, modulus=_MODULUS, friction=friction)
        for i, (_, bar, at) in enumerate(bars, start=1)
    ]


def _Bars(
    x: float, y: float, *, length_x: float, length_y: float
) -> list[tuple[str, Box, tuple[float, float, float]]]:
    """Return side, shape and position of the frame's bars, with two lengths, m."""
    a, b = (x + _EDGE) / 2, (y + _EDGE) / 2
    long, short = Box(_EDGE, length_y, _BAR_HEIGHT), Box(length_x, _EDGE, _BAR_HEIGHT)
    return [
        ("near", long, (-a, 0.0, _BAR_Z)),
        ("far", long, (a, 0.0, _BAR_Z)),
        ("right", short, (0.0, -b, _BAR_Z)),
        ("left", short, (0.0, b, _BAR_Z)),
    ]


def _Corners(x: float, y: float, inset: float) -> list[tuple[float, float]]:
    a, b = x / 2 - inset, y / 2 - inset
    return [(a, b), (a, -b), (-a, b), (-a, -b)]


def _Legs(x: float, y: float) -> list[Visual]:
    leg, foot = Cylinder(0.012, 0.072), Cylinder(0.020, 0.008)
    legs = []
    for i, corner in enumerate(_Corners(x, y, 0.03), start=1):
        legs.append(Visual(f"leg_{i}", leg, at=(*corner, -0.056), colour=_METAL))
        legs.append(Visual(f"foot_{i}", foot, at=(*corner, -0.096), colour=_DARK))
    return legs


def _Post(config: BoardConfig) -> list[Visual]:
    """Return the visuals of a post from the slab to the floor."""
    length = max(config.translation[2] - _THICKNESS, 0.02)
    post, foot = Cylinder(0.020, length), Cylinder(0.060, 0.008)
    bottom = -_THICKNESS - length
    return [
        Visual("post", post, at=(0.0, 0.0, bottom + length / 2), colour=_METAL),
        Visual("foot", foot, at=(0.0, 0.0, bottom + 0.004), colour=_DARK),
    ]


def _Mount(x: float, y: float) -> list[Visual]:
    """Return the visuals of two rails behind the slab, and a plate between them."""
    rail, plate = Box(0.72 * x, 0.03, 0.014), Box(0.16 * x, 0.5 * y + 0.03, 0.012)
    return [
        Visual("rail_1", rail, at=(0, 0.25 * y, -0.027), colour=_METAL),
        Visual("rail_2", rail, at=(0, -0.25 * y, -0.027), colour=_METAL),
        Visual("plate", plate, at=(0, 0, -0.040), colour=_DARK),
    ]


def cell_of(surface: Surface) -> tuple[float, float]:
    """Return the longest edges of a mesh along u and v, m; infinite along straight lines.

    An edge of length L deviates from a circle of radius R by L² / 8R.
    """
    u, v = (
        math.sqrt(8 * _DEVIATION * _COMPRESSION / abs(k)) if k else math.inf
        for k in surface
    )
    return u, v


def closed_axes(size: Sequence[float], surface: Surface) -> list[bool]:
    """Return whether the edges of a board across x and y meet, as those of a pipe."""
    lengths = zip(size, surface.circumference, strict=True)
    return [a > length - _SEAM for a, length in lengths]


def curved_slab(
    surface: Surface, size: tuple[float, float], thickness: float
) -> tuple[Array, Array, Faces]:
    """Return the mesh of a slab below a surface.

    The triangles are on the surface on average: the vertices of a dome are above it, those
    of a bowl below it.

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
        Outward, for shading.
    faces : array of int, shape (M, 3)
        Counterclockwise, seen from outside.

    Notes
    -----
    Deviations of an arm that wipes for 4 s with 10 N from one on a mesh with edges of 7 mm
    (cylinder: 10 mm), root mean square, and faces of the contact:

    =========================== ========= ===== ======= =========
    board of radius 0.3 m       edges     faces force   position
    =========================== ========= ===== ======= =========
    bowl, this mesh             22 mm     154   0.06 N  0.02 mm
    bowl, vertices on it        15 mm     221   0.02 N  0.10 mm
    bowl, longer edges          31 mm     118   0.15 N  0.06 mm
    dome, this mesh             22 mm     118   0.02 N  0.01 mm
    dome, vertices on it        15 mm     168   0.01 N  0.10 mm
    cylinder, this mesh         22 mm     57    0.03 N  0.01 mm
    cylinder, vertices on it    22 mm     57    0.03 N  0.11 mm
    =========================== ========= ===== ======= =========

    A contact of 100 faces more takes about 0.6 ms more for a step of 1 ms.
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
    cell = np.divide(size, (nu, nv))
    # An arc is two thirds of its height above its chord on average.
    uvh[0, ..., 2] = 2 / 3 * np.dot(surface, cell**2 / 8)
    uvh[1, ..., 2] = -thickness
    index = np.arange(uvh[..., 0].size).reshape(uvh.shape[:3])
    top, bottom = index
    quads = [_quads(top), _quads(bottom)[:, ::-1]]
    is_closed = closed_axes(size, surface)
    if not is_closed[0]:
        quads += [_quads(index[::-1, 0]), _quads(index[:, -1])]
    if not is_closed[1]:
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


def _CurvedSlab(config: BoardConfig) -> list[Visual | Collision]:
    """Return contact and visual geometry of a curved slab.

    The slab is rigid; the compliance of the felt is sufficient.
    """
    x, y = config.size
    mesh = curved_slab(config.curvature(), (x, y), min(_THICKNESS, config.radius / 2))
    shape = Mesh(InMemoryMesh(mesh_file=MemoryFile(_obj(*mesh), ".obj", "slab")))
    friction = config.friction
    return [
        Collision("slab", shape, at=_ORIGIN, modulus=math.inf, friction=friction),
        Visual("slab", shape, at=_ORIGIN, colour=_WHITE),
    ]


def _obj(vertices: Array, normals: Array, faces: Faces) -> str:
    """Return a mesh as Wavefront OBJ."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in normals]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"


def FilterHull(
    plant: MultibodyPlant, scene_graph: SceneGraph, whiteboard: ModelInstanceIndex
) -> None:
    """Exclude contact of a concave board with shapes that are not hydroelastic.

    The contact geometry of a mesh for these is its convex hull, which would cover a bowl.
    The `SurfaceMonitor` reports rigid bodies there.

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
    slab = GeometrySet([g for g in ids if inspector.GetFrameId(g) == board])
    points = GeometrySet([g for g in ids if not _is_hydroelastic(inspector, g)])
    declaration = CollisionFilterDeclaration().ExcludeBetween(slab, points)
    scene_graph.collision_filter_manager().Apply(declaration)


def _is_hydroelastic(inspector: Any, geometry: GeometryId) -> bool:
    properties = inspector.GetProximityProperties(geometry)
    return bool(properties.HasProperty("hydroelastic", "compliance_type"))
