"""Facts about the arrow of the contact force."""

import pytest
from numpy.testing import assert_allclose
from pydrake.common.value import Value
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    Meshcat,
    ProximityProperties,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactResults,
    CoulombFriction,
)
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import SystemsError
from fmp_drake.systems.page.force_arrow import ForceArrow

MASS = 2.0
WEIGHT = MASS * 9.81
SIDE = 0.1


class Drawings:
    """In place of a Meshcat: what was drawn last, by path."""

    def __init__(self):
        self.poses, self.properties, self.objects = {}, {}, {}

    def Delete(self, _):
        self.objects.clear()

    def SetObject(self, path, shape, _):
        self.objects[path] = shape

    def SetTransform(self, path, pose, _=None):
        self.poses[path] = pose

    def SetProperty(self, path, name, value, time_in_recording=None):  # noqa: ARG002
        self.properties[path, name] = value


def make_diagram(meshcat, *, height=SIDE / 2, box_first=False):
    """A box on the ground, or above it, and another one beside it.

    Drake orders the two bodies of a contact as their geometries were registered.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    soft, hard = ProximityProperties(), ProximityProperties()
    AddCompliantHydroelasticProperties(0.02, 1e6, soft)
    AddRigidHydroelasticProperties(0.5, hard)
    for properties in (soft, hard):
        AddContactMaterial(10.0, None, CoulombFriction(0.5, 0.5), properties)
    inertia = SpatialInertia.SolidBoxWithMass(MASS, SIDE, SIDE, SIDE)
    box, other = (plant.AddRigidBody(name, inertia) for name in ("box", "other"))
    cube, below = Box(SIDE, SIDE, SIDE), RigidTransform([0, 0, -0.1])
    shapes = [
        (plant.world_body(), below, Box(1, 1, 0.2), "ground", hard),
        (box, RigidTransform(), cube, "box", soft),
        (other, RigidTransform(), cube, "other", soft),
    ]
    for shape in shapes[::-1] if box_first else shapes:
        plant.RegisterCollisionGeometry(*shape)
    plant.Finalize()
    plant.SetDefaultFloatingBaseBodyPose(box, RigidTransform([0.2, 0.1, height]))
    plant.SetDefaultFloatingBaseBodyPose(other, RigidTransform([-0.2, 0, SIDE / 2]))
    arrow = builder.AddSystem(ForceArrow(plant, body=box, meshcat=meshcat))
    builder.Connect(
        plant.get_contact_results_output_port(), arrow.GetInputPort("contact_results")
    )
    return builder.Build(), arrow


@pytest.fixture
def drawings():
    return Drawings()


def test_its_port_has_a_name(drawings):
    _, arrow = make_diagram(drawings)
    assert arrow.get_name() == "force_arrow"
    assert arrow.num_output_ports() == 0
    assert arrow.num_input_ports() == 1
    assert arrow.get_input_port().get_name() == "contact_results"


@pytest.mark.parametrize("box_first", [False, True])
def test_the_arrow_of_a_resting_box_is_its_weight(drawings, box_first):
    diagram, _ = make_diagram(drawings, box_first=box_first)
    Simulator(diagram).AdvanceTo(1.0)
    pose = drawings.poses["/force"]
    assert_allclose(pose.translation(), [0.2, 0.1, 0.0], atol=2e-3)
    assert_allclose(pose.rotation().col(2), [0, 0, 1], atol=1e-3)
    # Shaft and head together.
    shaft = drawings.poses["/force/head"].translation()[2]
    assert drawings.properties["/force/stretch", "scale"] == [1.0, 1.0, shaft]
    assert_allclose(shaft + 0.022, 0.012 * WEIGHT, rtol=0.02)
    assert drawings.properties["/force", "visible"] is True


def test_a_body_in_the_air_has_no_arrow(drawings):
    diagram, _ = make_diagram(drawings, height=1.0)
    Simulator(diagram).AdvanceTo(0.1)
    assert drawings.properties["/force", "visible"] is False


def test_the_arrow_appears_with_the_contact(drawings):
    diagram, _ = make_diagram(drawings, height=SIDE / 2 + 0.02)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.01)
    assert drawings.properties["/force", "visible"] is False
    simulator.AdvanceTo(1.0)
    assert drawings.properties["/force", "visible"] is True


def test_the_arrow_is_drawn_once_and_then_moved():
    meshcat = Meshcat()
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.Initialize()
    sent = meshcat._GetPackedObject("/force/stretch/shaft")
    assert len(sent) > 0
    before = meshcat._GetPackedTransform("/force")
    simulator.AdvanceTo(0.5)
    assert meshcat._GetPackedObject("/force/stretch/shaft") == sent
    assert meshcat._GetPackedTransform("/force") != before


def test_it_needs_contact_results(drawings):
    _, arrow = make_diagram(drawings)
    with pytest.raises(RuntimeError, match=r"contact_results.*force_arrow"):
        Simulator(arrow).Initialize()
    context = arrow.CreateDefaultContext()
    arrow.get_input_port().FixValue(context, Value(ContactResults()))
    arrow.ForcedPublish(context)


def test_values_that_do_not_fit_are_refused(drawings):
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    ghost = plant.AddRigidBody("ghost")
    plant.Finalize()
    with pytest.raises(SystemsError, match="'ghost' has no collision geometry"):
        ForceArrow(plant, body=ghost, meshcat=drawings)
