"""Callbacks, cache entries and ports that several systems declare.

The callbacks do not keep their system alive. Drake stores the function of a cache entry or
of an abstract output port outside of Python's garbage collection. A `CacheEntry` likewise
refers to its system. A system that passed its own methods, or stored a `CacheEntry`, would
never be freed, nor the diagram around it: 20 MB for a wiping station.
"""

import weakref
from collections.abc import Callable, Iterator
from typing import Any

from pydrake.common.value import Value
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import (
    ContactResults,
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import BodyIndex, Frame, RigidBody
from pydrake.systems.framework import (
    CacheIndex,
    Context,
    DependencyTicket,
    InputPort,
    LeafSystem,
    ValueProducer,
)

from fmp_drake.errors import FmpError, SystemsError
from fmp_drake.numeric import Array, check_type


def weakly(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls a method through a weak reference to its object."""
    reference = weakref.WeakMethod(method)

    def call(*arguments: Any) -> Any:
        bound_method = reference()
        assert bound_method is not None
        return bound_method(*arguments)

    return call


def declare_cache(
    system: LeafSystem,
    name: str,
    calc: Callable[[Any, Any], None],
    prerequisites: set[DependencyTicket],
) -> CacheIndex:
    """Declare a cache entry that a method of its system computes.

    `eval_cache` evaluates it; its ticket is ``system.cache_entry_ticket(index)``.
    """
    return system.DeclareCacheEntry(
        name, ValueProducer(allocate=Value[object], calc=weakly(calc)), prerequisites
    ).cache_index()


def check_frame(
    frame: Frame, what: str, plant: MultibodyPlant, *, error: type[FmpError]
) -> None:
    """Raise an error for a frame of another plant.

    Drake would take the plant's own frame with the same index.
    """
    check_type(frame, what, Frame, error=error)
    if frame.GetParentPlant() is not plant:
        raise error(
            f"{what} {frame.name()} is a frame of another plant; give one of this plant."
        )


def collision_ids(plant: MultibodyPlant, body: RigidBody) -> frozenset[int]:
    """Return the values of the identifiers of a body's collision geometries.

    A `GeometryId` from a plant would keep the plant alive.

    Raises
    ------
    SystemsError
        If the body has none.
    """
    identifiers = plant.GetCollisionGeometriesForBody(body)
    if not identifiers:
        raise SystemsError(
            f"The body '{body.name()}' has no collision geometry, so nothing can touch "
            "it: add hydroelastic collision geometry, and register the plant with a "
            "SceneGraph first."
        )
    return frozenset(identifier.get_value() for identifier in identifiers)


def contact_surfaces(
    results: ContactResults, geometries: frozenset[int]
) -> Iterator[tuple[ContactSurface, Any, int]]:
    """Yield the contact surfaces of a body, with the force on it and the other geometry.

    Parameters
    ----------
    results : ContactResults
    geometries : frozenset of int
        Of the body, as `collision_ids` returns them.

    Yields
    ------
    surface : ContactSurface
    force : array, shape (3,)
        On the body, in W, N.
    other : int
        Value of the identifier of the other geometry.
    """
    for i in range(results.num_hydroelastic_contacts()):
        info = results.hydroelastic_contact_info(i)
        surface, force = info.contact_surface(), info.F_Ac_W().translational()
        m, n = surface.id_M().get_value(), surface.id_N().get_value()
        # The force acts on the body of M.
        if m in geometries:
            yield surface, force, n
        elif n in geometries:
            yield surface, -force, m


def declare_bodies(system: LeafSystem) -> tuple[InputPort, InputPort]:
    """Declare input ports for a plant's `body_poses` and `body_spatial_velocities`."""
    return (
        system.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]()),
        system.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[list[SpatialVelocity]]()
        ),
    )


def declare_spatial_forces(
    system: LeafSystem,
    calc: Callable[[Any, Any], None],
    prerequisites: set[DependencyTicket],
) -> None:
    """Declare an output port `spatial_forces`, a list for a plant."""
    system.DeclareAbstractOutputPort(
        "spatial_forces",
        Value[list[ExternallyAppliedSpatialForce]],
        weakly(calc),
        prerequisites_of_calc=prerequisites,
    )


def spatial_force(
    body: int, p_BoBq_B: Array, torque_W: Array, force_W: Array
) -> ExternallyAppliedSpatialForce:
    """Return a spatial force on a body for a plant.

    Parameters
    ----------
    body : int
        Index of the body B.
    p_BoBq_B : array, shape (3,)
        Point of application Bq, in B, m.
    torque_W, force_W : array, shape (3,)
        In W, Nm and N.
    """
    applied = ExternallyAppliedSpatialForce()
    applied.body_index = BodyIndex(body)
    applied.p_BoBq_B = p_BoBq_B
    applied.F_Bq_W = SpatialForce(torque_W, force_W)
    return applied


def eval_number(
    port: InputPort, context: Context, default: float | None = None
) -> float:
    """Return the value of a port of size 1, or the default where it has none."""
    if default is not None and not port.HasValue(context):
        return default
    value: Any = port.Eval(context)
    return float(value[0])


def eval_cache(system: LeafSystem, index: CacheIndex, context: Context) -> Any:
    """Return the up-to-date value of a cache entry."""
    return system.get_cache_entry(index).Eval(context)
