"""A box eraser that slides without friction on a board that can slide, too."""

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
)

from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink_board import InkBoard

GRID = InkGrid(size=(0.4, 0.3), cell=0.005)
FELT = (0.12, 0.05)
PERIOD = 0.05
MODULUS = 1.25e4
GRAVITY = 9.81
X_WB = RigidTransform(RollPitchYaw(0.0, 0.0, 0.5), [0.5, 0.1, 0.2])
OUTPUTS = [
    "ink",
    "cleaned_fraction",
    "normal_force",
    "contact_area",
]
INPUTS = ["contact_results", "body_poses", "body_spatial_velocities"]
AXES = np.eye(3)


def make_plant(builder, *, force=10.0, eraser_first=False, faces="polygon"):
    """Add a board that can slide in the world and an eraser on x, y, z and yaw."""
    plant, _ = AddMultibodyPlant(
        MultibodyPlantConfig(
            time_step=1e-3,
            discrete_contact_approximation="lagged",
            contact_model="hydroelastic",
            contact_surface_representation=faces,
        ),
        builder,
    )

    def add(name, mass, size, properties, X_BodyG):
        body = plant.AddRigidBody(name, SpatialInertia.SolidBoxWithMass(mass, *size))
        AddContactMaterial(
            dissipation=20.0, friction=CoulombFriction(0.0, 0.0), properties=properties
        )
        plant.RegisterCollisionGeometry(body, X_BodyG, Box(*size), name, properties)
        return body

    def add_board():
        rigid = ProximityProperties()
        AddRigidHydroelasticProperties(0.1, rigid)
        size = (0.6, 0.5, 0.02)
        return add("board", 1.0, size, rigid, RigidTransform([0.1, 0.0, -0.03]))

    def add_eraser():
        soft = ProximityProperties()
        AddCompliantHydroelasticProperties(0.1, MODULUS, soft)
        size = (*FELT, 0.03)
        return add("eraser", force / GRAVITY, size, soft, RigidTransform([0, 0, 0.015]))

    if eraser_first:
        eraser, board = add_eraser(), add_board()
    else:
        board, eraser = add_board(), add_eraser()
    # B is off the board's body frame.
    X_BoardB = RigidTransform([0.1, 0.0, -0.02])
    surface = plant.AddFrame(FixedOffsetFrame("surface", board.body_frame(), X_BoardB))
    start = plant.AddFrame(
        FixedOffsetFrame("start", plant.world_frame(), X_WB @ X_BoardB.inverse())
    )
    plant.AddJoint(PrismaticJoint("slide", start, board.body_frame(), AXES[0]))
    parent = plant.AddFrame(FixedOffsetFrame("parent", plant.world_frame(), X_WB))
    for name, axis in zip("xyz", AXES, strict=True):
        light = SpatialInertia.SolidBoxWithMass(1e-6, 0.1, 0.1, 0.1)
        body = plant.AddRigidBody(f"carriage_{name}", light)
        plant.AddJoint(PrismaticJoint(name, parent, body.body_frame(), axis))
        parent = body.body_frame()
    plant.AddJoint(RevoluteJoint("yaw", parent, eraser.body_frame(), AXES[2]))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
    plant.Finalize()
    return plant, eraser, surface


def add_ink(builder, plant, eraser, surface, *, inputs=INPUTS, **options):
    options = {"period": PERIOD} | options
    board = InkBoard(
        plant=plant,
        eraser=eraser.body_frame(),
        surface=surface,
        grid=GRID,
        **options,
    )
    builder.AddSystem(board)
    for name in inputs:
        builder.Connect(plant.GetOutputPort(name), board.GetInputPort(name))
    return board
