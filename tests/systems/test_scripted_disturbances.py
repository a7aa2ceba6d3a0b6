"""Facts about scripted pushes and grasps."""

from dataclasses import replace

import numpy as np
import pytest
from arm_loop import make_arm
from numpy.testing import assert_allclose
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity

from fmp_drake.errors import SystemsError
from fmp_drake.systems.scripted_disturbances import Disturbance, ScriptedDisturbances

# The frame B is that of the world, but for a rotation by 90 degrees about z.
X_WB = RigidTransform(RotationMatrix.MakeZRotation(np.pi / 2), [0.0, 0.0, 0.1])
FORCE = np.array([1.0, 2.0, 3.0])
PUSH = Disturbance(start=1.0, duration=0.5, force=[2.0, -1.0, 3.0])
GRASP = Disturbance(
    kind="grasp",
    start=2.0,
    duration=1.0,
    position=[0.2, -0.1, 0.2],
    stiffness=500.0,
    max_force=20.0,
)


@pytest.fixture(scope="module")
def plant():
    return make_arm()


@pytest.fixture(scope="module")
def tip(plant):
    return plant.GetFrameByName("eraser_tip")


def context_of(system, plant, *, time, X_WE=None, V_WE=None):
    """Fix the tool's pose and spatial velocity, which are the tip's."""
    context = system.CreateDefaultContext()
    context.SetTime(time)
    X_EBody = plant.GetFrameByName("eraser_tip").GetFixedPoseInBodyFrame().inverse()
    poses = [RigidTransform()] * plant.num_bodies()
    velocities = [SpatialVelocity(np.zeros(3), np.zeros(3))] * plant.num_bodies()
    index = plant.GetBodyByName("eraser").index()
    X_WE = X_WE or RigidTransform()
    poses[index] = X_WE @ X_EBody
    if V_WE is not None:
        arm = X_WE.rotation() @ X_EBody.translation()
        velocities[index] = V_WE.Shift(arm)
    system.GetInputPort("body_poses").FixValue(
        context, Value[list[RigidTransform]](poses)
    )
    system.GetInputPort("body_spatial_velocities").FixValue(
        context, Value[list[SpatialVelocity]](velocities)
    )
    return context


def test_ports_have_names(tip):
    system = ScriptedDisturbances(grip=tip, disturbances=[PUSH], X_WB=X_WB)
    assert system.get_name() == "disturbances"
    for name in ("body_poses", "body_spatial_velocities"):
        system.GetInputPort(name)
    assert system.GetOutputPort("force").size() == 3
    assert not system.HasDirectFeedthrough(0, 0)
    assert ScriptedDisturbances(
        grip=tip, disturbances=[GRASP], X_WB=X_WB
    ).HasDirectFeedthrough(0, 0)


@pytest.mark.parametrize(
    ("time", "acts"),
    [(0.99, False), (1.0, True), (1.49, True), (1.5, False), (3.2, False)],
)
def test_push_acts_from_its_start_for_its_duration(plant, tip, time, acts):
    system = ScriptedDisturbances(grip=tip, disturbances=[PUSH], X_WB=X_WB)
    context = context_of(system, plant, time=time)
    force = system.GetOutputPort("force").Eval(context)
    assert_allclose(force, FORCE if acts else np.zeros(3))
    forces = system.GetOutputPort("spatial_forces").Eval(context)
    assert len(forces) == int(acts)


def test_disturbance_repeats():
    again = Disturbance(start=1.0, duration=0.5, every=2.0)
    for time in (1.2, 3.2, 41.4):
        assert again.is_active(time)
    for time in (0.5, 1.7, 2.9, 42.6):
        assert not again.is_active(time)


def test_force_acts_at_the_origin_of_the_grip(plant, tip):
    system = ScriptedDisturbances(grip=tip, disturbances=[PUSH], X_WB=X_WB)
    context = context_of(system, plant, time=1.1)
    (applied,) = system.GetOutputPort("spatial_forces").Eval(context)
    assert applied.body_index == plant.GetBodyByName("eraser").index()
    assert_allclose(applied.p_BoBq_B, tip.GetFixedPoseInBodyFrame().translation())
    assert_allclose(applied.F_Bq_W.translational(), FORCE)
    assert_allclose(applied.F_Bq_W.rotational(), 0)


def test_a_grasp_is_a_damped_spring_to_its_point(plant, tip):
    system = ScriptedDisturbances(grip=tip, disturbances=[GRASP], X_WB=X_WB)
    X_WE = RigidTransform(RotationMatrix.MakeZRotation(0.7), [0.09, 0.21, 0.31])
    v = np.array([0.01, -0.02, 0.03])
    V = SpatialVelocity(np.array([0.3, -0.2, 0.1]), v)
    context = context_of(system, plant, time=2.5, X_WE=X_WE, V_WE=V)
    expected = 500 * np.array([0.01, -0.01, -0.01]) - 2 * np.sqrt(500 * 5) * v
    assert_allclose(system.GetOutputPort("force").Eval(context), expected, atol=1e-9)


def test_a_grasp_pulls_no_harder_than_a_person(plant, tip):
    system = ScriptedDisturbances(grip=tip, disturbances=[GRASP], X_WB=X_WB)
    X_WE = RigidTransform([0.1, 0.2, 1.3])
    context = context_of(system, plant, time=2.5, X_WE=X_WE)
    force = system.GetOutputPort("force").Eval(context)
    assert_allclose(force, [0, 0, -20], atol=1e-9)


def test_forces_of_one_time_add_up(plant, tip):
    other = Disturbance(start=0.0, duration=9.0, force=[0.0, 0.0, -1.0])
    system = ScriptedDisturbances(grip=tip, disturbances=[PUSH, other], X_WB=X_WB)
    context = context_of(system, plant, time=1.2)
    assert_allclose(system.GetOutputPort("force").Eval(context), [1, 2, 2])


def test_caching_makes_no_difference(plant, tip):
    system = ScriptedDisturbances(grip=tip, disturbances=[PUSH, GRASP], X_WB=X_WB)
    for cached in (True, False):
        context = context_of(system, plant, time=0.5)
        if not cached:
            context.DisableCaching()
        rows = []
        for time in (0.5, 1.2, 2.5, 4.0):
            context.SetTime(time)
            rows.append(system.GetOutputPort("force").Eval(context).copy())
        if cached:
            first = rows
    assert np.array_equal(first, rows)
    assert_allclose(np.linalg.norm(rows, axis=1), [0, 14**0.5, 20, 0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "pull"}, "kind is pull; choose one of"),
        ({"force": [np.nan, 0.0, 0.0]}, r"disturbance force\[0\] is nan"),
        ({"force": [1.0, 0.0]}, "expected 3 numbers"),
    ],
)
def test_disturbance_that_cannot_be_is_refused(tip, changes, message):
    disturbance = replace(PUSH, **changes)
    with pytest.raises(SystemsError, match=message):
        ScriptedDisturbances(grip=tip, disturbances=[disturbance], X_WB=X_WB)
