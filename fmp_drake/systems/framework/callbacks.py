"""What a system gives to Drake and does not want to be kept alive by.

Drake holds what computes a cache entry or an abstract output port where Python's garbage
collection does not see it, and a `CacheEntry` holds its system. A system that gave away its
own methods, or kept a `CacheEntry`, would never be freed, nor the diagram around it: 20 MB
for a wiping station.
"""

import weakref
from collections.abc import Callable
from typing import Any

from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import (
    CacheIndex,
    Context,
    DependencyTicket,
    LeafSystem,
    ValueProducer,
)


def weakly(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls a method, and does not keep its object alive."""
    kept = weakref.WeakMethod(method)

    def call(*arguments: Any) -> Any:
        found = kept()
        assert found is not None
        return found(*arguments)

    return call


def declare_cache(
    system: LeafSystem,
    name: str,
    calc: Callable[[Any, Any], None],
    prerequisites: set[DependencyTicket],
    *,
    allocate: Callable[[], Any] = Value[object],
) -> CacheIndex:
    """Declare a cache entry that a method of its system computes.

    `eval_cache` evaluates it; its ticket is ``system.cache_entry_ticket(index)``.
    """
    return system.DeclareCacheEntry(
        name, ValueProducer(allocate=allocate, calc=weakly(calc)), prerequisites
    ).cache_index()


def collision_ids(plant: MultibodyPlant, body: RigidBody) -> frozenset[int]:
    """Return the values of the identifiers of a body's collision geometries.

    Each `GeometryId` that a plant returns would keep it alive.
    """
    found = plant.GetCollisionGeometriesForBody(body)
    return frozenset(each.get_value() for each in found)


def eval_cache(system: LeafSystem, index: CacheIndex, context: Context) -> Any:
    """Return the value of a cache entry that is up to date."""
    return system.get_cache_entry(index).Eval(context)
