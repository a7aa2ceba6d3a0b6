"""Facts about adding forces on bodies."""

import pytest
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex

from fmp_drake.errors import SystemsError
from fmp_drake.systems.spatial_force_sum import SpatialForceSum


def force(newtons):
    result = ExternallyAppliedSpatialForce()
    result.body_index = BodyIndex(1)
    result.F_Bq_W = SpatialForce([0, 0, 0, newtons, 0, 0])
    return result


def fix(system, context, name, newtons):
    value = Value[list[ExternallyAppliedSpatialForce]]([force(n) for n in newtons])
    return system.GetInputPort(name).FixValue(context, value)


def newtons(system, context):
    forces = system.GetOutputPort("spatial_forces").Eval(context)
    return [f.F_Bq_W.translational()[0] for f in forces]


@pytest.fixture
def system():
    return SpatialForceSum("push", "mouse", "applied")


def test_ports_have_names(system):
    assert system.get_name() == "spatial_force_sum"
    names = [system.get_input_port(i).get_name() for i in range(3)]
    assert names == ["push", "mouse", "applied"]
    assert all(system.HasDirectFeedthrough(i, 0) for i in range(3))


def test_the_output_is_all_inputs_in_their_order(system):
    context = system.CreateDefaultContext()
    fix(system, context, "push", [1.0])
    fix(system, context, "mouse", [])
    fix(system, context, "applied", [2.0, 3.0])
    assert newtons(system, context) == [1.0, 2.0, 3.0]


def test_an_input_that_is_not_connected_has_no_forces(system):
    context = system.CreateDefaultContext()
    assert newtons(system, context) == []
    fix(system, context, "applied", [2.0])
    assert newtons(system, context) == [2.0]


@pytest.mark.parametrize("caching", [True, False])
def test_the_output_follows_its_inputs(system, caching):
    contexts = [system.CreateDefaultContext() for _ in range(2)]
    for context in contexts:
        if not caching:
            context.DisableCaching()
        fix(system, context, "push", [1.0])
        assert newtons(system, context) == [1.0]
    fix(system, contexts[0], "push", [5.0])
    assert newtons(system, contexts[0]) == [5.0]
    assert newtons(system, contexts[1]) == [1.0]


def test_nothing_to_add_is_refused():
    with pytest.raises(SystemsError, match="at least one"):
        SpatialForceSum()
