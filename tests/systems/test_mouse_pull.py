"""Facts about the pull of the mouse."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import SystemsError
from fmp_drake.systems.mouse_pull import MousePull

SPECIFIC = 100.0
MASSES = {1: 0.25, 2: 5.0}


@pytest.fixture(scope="module")
def plant():
    plant = MultibodyPlant(1e-3)
    for index, mass in MASSES.items():
        body = plant.AddRigidBody(
            f"body_{index}", SpatialInertia.SolidSphereWithMass(mass, 0.1)
        )
        assert int(body.index()) == index
    ghost = plant.AddRigidBody("ghost")
    plant.WeldFrames(plant.world_frame(), ghost.body_frame())
    plant.Finalize()
    return plant


def make_pull(plant, **options):
    return MousePull(plant, specific_stiffness=SPECIFIC, **options)


def spring(body, stretch):
    """Return what Drake's spring gives at rest for a stretch in m."""
    force = ExternallyAppliedSpatialForce()
    force.body_index = BodyIndex(body)
    force.p_BoBq_B = [0.1, 0.2, 0.3]
    push = SPECIFIC * MASSES.get(body, 0.0) * np.array(stretch, dtype=float)
    force.F_Bq_W = SpatialForce(np.concatenate([np.zeros(3), push]))
    return force


def drag(pull, context, *forces):
    value = Value[list[ExternallyAppliedSpatialForce]](list(forces))
    pull.GetInputPort("spring").FixValue(context, value)


def pulls(pull, simulator):
    return pull.GetOutputPort("spatial_force").Eval(simulator.get_context())


def begin(pull, *forces):
    simulator = Simulator(pull)
    drag(pull, simulator.get_mutable_context(), *forces)
    simulator.Initialize()
    return simulator


def test_ports_have_names_and_no_feedthrough(plant):
    pull = make_pull(plant)
    assert pull.get_name() == "mouse_pull"
    assert pull.get_input_port().get_name() == "spring"
    assert pull.get_output_port().get_name() == "spatial_force"
    assert not pull.HasAnyDirectFeedthrough()


@pytest.mark.parametrize("body", MASSES)
def test_every_body_feels_the_same_stiffness_where_it_is_grabbed(plant, body):
    pull = make_pull(plant, stiffness=300.0)
    simulator = begin(pull, spring(body, [0.0, 0.03, 0.04]))
    simulator.AdvanceTo(0.001)
    (force,) = pulls(pull, simulator)
    assert int(force.body_index) == body
    assert_array_equal(force.p_BoBq_B, [0.1, 0.2, 0.3])
    assert_allclose(force.F_Bq_W.translational(), [0.0, 9.0, 12.0])
    assert_array_equal(force.F_Bq_W.rotational(), np.zeros(3))


def test_the_force_has_a_limit(plant):
    pull = make_pull(plant, stiffness=300.0, max_force=40.0)
    simulator = begin(pull, spring(2, [0.3, 0.0, 0.4]))
    simulator.AdvanceTo(0.001)
    (force,) = pulls(pull, simulator)
    assert_allclose(force.F_Bq_W.translational(), [24.0, 0.0, 32.0])


@pytest.mark.parametrize("caching", [True, False])
def test_the_mouse_is_read_at_a_rate(plant, caching):
    pull = make_pull(plant, period=0.1)
    simulator = begin(pull, spring(1, [0.01, 0.0, 0.0]))
    if not caching:
        simulator.get_mutable_context().DisableCaching()
    assert pulls(pull, simulator) == []
    simulator.AdvanceTo(0.05)
    assert len(pulls(pull, simulator)) == 1
    drag(pull, simulator.get_mutable_context())
    assert len(pulls(pull, simulator)) == 1
    simulator.AdvanceTo(0.15)
    assert pulls(pull, simulator) == []


def test_a_continued_run_goes_on_pulling_until_the_mouse_lets_go(plant):
    pull = make_pull(plant)
    simulator = begin(pull, spring(1, [0.01, 0.0, 0.0]))
    simulator.AdvanceTo(0.055)
    copy = Simulator(pull, simulator.get_context().Clone())
    copy.Initialize()
    (one,), (other,) = pulls(pull, simulator), pulls(pull, copy)
    assert_array_equal(one.F_Bq_W.get_coeffs(), other.F_Bq_W.get_coeffs())
    drag(pull, copy.get_mutable_context())
    copy.AdvanceTo(0.07)
    assert pulls(pull, copy) == []


def test_two_simulations_do_not_disturb_each_other(plant):
    pull = make_pull(plant)
    simulators = [begin(pull, spring(1, [0.01, 0, 0])), begin(pull)]
    for simulator in simulators:
        simulator.AdvanceTo(0.05)
    assert [len(pulls(pull, s)) for s in simulators] == [1, 0]


@pytest.mark.parametrize(
    "force", [spring(3, [0.1, 0, 0]), spring(1, [np.nan, 0, 0])], ids=["ghost", "nan"]
)
def test_a_body_without_mass_and_nonsense_are_not_pulled(plant, force):
    pull = make_pull(plant)
    simulator = begin(pull, force)
    simulator.AdvanceTo(0.05)
    assert pulls(pull, simulator) == []


def test_a_forgotten_input_is_named(plant):
    with pytest.raises(RuntimeError, match=r"spring.*mouse_pull"):
        Simulator(make_pull(plant)).AdvanceTo(0.1)


@pytest.mark.parametrize("name", ["stiffness", "max_force", "period"])
def test_values_that_do_not_fit_are_refused(plant, name):
    with pytest.raises(SystemsError, match=f"{name} is -1.0; it must be positive"):
        make_pull(plant, **{name: -1.0})
