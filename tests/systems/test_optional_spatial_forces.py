"""Facts about forces on bodies from a port that may stay unconnected."""

import pytest
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex

from fmp_drake.systems.optional_spatial_forces import OptionalSpatialForces


def force(newtons):
    result = ExternallyAppliedSpatialForce()
    result.body_index = BodyIndex(1)
    result.F_Bq_W = SpatialForce([0, 0, 0, newtons, 0, 0])
    return result


def fix(system, context, newtons):
    value = Value[list[ExternallyAppliedSpatialForce]]([force(n) for n in newtons])
    return system.GetInputPort("forces").FixValue(context, value)


def newtons(system, context):
    forces = system.GetOutputPort("spatial_forces").Eval(context)
    return [f.F_Bq_W.translational()[0] for f in forces]


@pytest.fixture
def system():
    return OptionalSpatialForces()


def test_ports_have_names(system):
    assert system.get_name() == "optional_spatial_forces"
    assert system.HasDirectFeedthrough(0, 0)


def test_an_input_that_is_not_connected_has_no_forces(system):
    assert newtons(system, system.CreateDefaultContext()) == []


@pytest.mark.parametrize("caching", [True, False])
def test_the_output_follows_its_input(system, caching):
    contexts = [system.CreateDefaultContext() for _ in range(2)]
    for context in contexts:
        if not caching:
            context.DisableCaching()
        assert newtons(system, context) == []
        fix(system, context, [1.0, 2.0])
        assert newtons(system, context) == [1.0, 2.0]
    fix(system, contexts[0], [5.0])
    assert newtons(system, contexts[0]) == [5.0]
    assert newtons(system, contexts[1]) == [1.0, 2.0]
