"""Facts about the simulated hand that guides the arm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PlanarJoint,
    PrismaticJoint,
    RigidBody,
    SpatialInertia,
    default_model_instance,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.systems.human_hand import (
    DAMPING,
    NORMAL_FORCE,
    ROTATIONAL_DAMPING,
    ROTATIONAL_STIFFNESS,
    STIFFNESS,
    HumanHand,
)
from fmp_drake.systems.surface.surface import Surface, place, rotation
from fmp_drake.systems.teaching.hand_motion import HandMotion

INPUTS = ("body_poses", "body_spatial_velocities")
OUTPUTS = ("spatial_forces", "position")
X_WB = RigidTransform(RollPitchYaw(0.2, -0.3, 0.7), [0.5, -0.1, 0.2])
X_LE = RigidTransform(RollPitchYaw(0.1, 0.4, -0.2), [0.02, -0.03, 0.1])
R_BE = RotationMatrix(np.diag([1.0, -1.0, -1.0]))
MOTION = HandMotion.make("eight", duration=4, seed=7)


def make_hand(motion=MOTION, surface=None):
    """Return a hand that holds a frame off the origin of a free body."""
    plant = MultibodyPlant(1e-3)
    body = plant.AddRigidBody("tool", SpatialInertia.SolidSphereWithMass(1.0, 0.05))
    grip = plant.AddFrame(FixedOffsetFrame("grip", body.body_frame(), X_LE))
    plant.Finalize()
    assert isinstance(body, RigidBody)
    return HumanHand(
        plant,
        grip=grip,
        X_WB=X_WB,
        motion=motion,
        R_BE=R_BE,
        surface=Surface() if surface is None else surface,
    )


@pytest.fixture(scope="module")
def hand():
    return make_hand()


def evaluate(hand, X_BE, V_WE=None, *, time=0.0, context=None):
    """Return torque and force in B at the grip, and the force itself.

    V_WE is the grip's velocity, rotation first, expressed in W.
    """
    context = hand.CreateDefaultContext() if context is None else context
    context.SetTime(time)
    X_WL = X_WB @ X_BE @ X_LE.inverse()
    p_EL_W = X_WL.translation() - (X_WB @ X_BE).translation()
    V_WE = SpatialVelocity(np.zeros(6) if V_WE is None else np.asarray(V_WE, float))
    world = RigidTransform()
    hand.GetInputPort("body_poses").FixValue(
        context, Value[list[RigidTransform]]([world, X_WL])
    )
    hand.GetInputPort("body_spatial_velocities").FixValue(
        context,
        Value[list[SpatialVelocity]](
            [SpatialVelocity(np.zeros(6)), V_WE.Shift(p_EL_W)]
        ),
    )
    (force,) = hand.GetOutputPort("spatial_forces").Eval(context)
    R_BW = X_WB.rotation().inverse()
    return (
        R_BW @ force.F_Bq_W.rotational(),
        R_BW @ force.F_Bq_W.translational(),
        force,
    )


def at_rest(time=0.0, offset=(0.0, 0.0, 0.0), tilt=None):
    """Return X_BE off the hand's target."""
    wanted, _ = MOTION.at(time)
    turned = R_BE if tilt is None else tilt @ R_BE
    return RigidTransform(turned, np.array([*wanted, 0.0]) + offset)


def test_ports_have_names_and_sizes(hand):
    assert hand.get_name() == "human_hand"
    assert [hand.get_input_port(i).get_name() for i in range(2)] == list(INPUTS)
    assert [hand.get_output_port(i).get_name() for i in range(2)] == list(OUTPUTS)
    assert hand.GetOutputPort("position").size() == 3


def test_force_follows_both_inputs_and_position_only_the_poses(hand):
    table = [[hand.HasDirectFeedthrough(i, o) for o in range(2)] for i in range(2)]
    assert table == [[True, True], [True, False]]


def test_system_has_no_state(hand):
    assert hand.CreateDefaultContext().is_stateless()


def test_position_is_the_grip_in_the_frame_of_the_board(hand):
    X_BE = RigidTransform(RollPitchYaw(1.0, 0.2, 3.0), [0.04, -0.05, 0.06])
    context = hand.CreateDefaultContext()
    evaluate(hand, X_BE, context=context)
    assert_allclose(
        hand.GetOutputPort("position").Eval(context), X_BE.translation(), atol=1e-12
    )


def test_force_acts_on_the_grip_of_the_tool(hand):
    *_, force = evaluate(hand, at_rest())
    assert int(force.body_index) == 1
    assert_allclose(force.p_BoBq_B, X_LE.translation())


@settings(deadline=None, max_examples=50)
@given(
    offset=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    velocity=st.tuples(*[st.floats(-1, 1)] * 3),
    spin=st.tuples(*[st.floats(-1, 1)] * 3),
    time=st.floats(0.0, 3.9),
)
def test_force_is_a_spring_a_damper_and_a_press(offset, velocity, spin, time):
    R_WB = X_WB.rotation()
    V_WE = np.concatenate([R_WB @ np.array(spin), R_WB @ np.array(velocity)])
    torque, force, _ = evaluate(make_hand(), at_rest(time, offset), V_WE, time=time)
    _, target_velocity = MOTION.at(time)
    expected = -DAMPING * (np.array(velocity) - [*target_velocity, 0.0])
    expected[:2] -= STIFFNESS * np.array(offset[:2])
    expected[2] -= NORMAL_FORCE
    assert_allclose(force, expected, atol=1e-9)
    assert_allclose(torque, -ROTATIONAL_DAMPING * np.array(spin), atol=1e-9)


@settings(deadline=None, max_examples=30)
@given(tilt=st.tuples(*[st.floats(-1.5, 1.5)] * 3))
def test_torque_turns_the_tool_back_level(tilt):
    turn = Rotation.from_rotvec(tilt).as_matrix()
    tilted = at_rest(tilt=RotationMatrix(turn))
    torque, *_ = evaluate(make_hand(), tilted)
    assert_allclose(torque, -ROTATIONAL_STIFFNESS * np.array(tilt), atol=1e-6)


def test_two_contexts_stay_independent(hand):
    contexts = [hand.CreateDefaultContext() for _ in range(2)]
    forces = [
        evaluate(hand, at_rest(offset=(x, 0, 0)), context=context)[1]
        for x, context in zip((0.01, -0.02), contexts, strict=True)
    ]
    for context, expected in zip(contexts, forces, strict=True):
        (force,) = hand.GetOutputPort("spatial_forces").Eval(context)
        assert_allclose(
            X_WB.rotation().inverse() @ force.F_Bq_W.translational(), expected
        )
    assert abs(forces[0][0] - forces[1][0]) > 40


def test_caching_changes_nothing(hand):
    seen = []
    for caching in (True, False):
        context = hand.CreateDefaultContext()
        if not caching:
            context.DisableCaching()
        X_BE = at_rest()
        # The time alone moves the target.
        seen.append(
            [evaluate(hand, X_BE, time=t, context=context)[1] for t in (0.0, 0.5, 1.0)]
        )
    assert_array_equal(*seen)
    assert np.ptp(seen[0], axis=0).max() > 10


@pytest.mark.parametrize("forgotten", INPUTS)
def test_forgotten_input_is_named(hand, forgotten):
    context = hand.CreateDefaultContext()
    if forgotten == "body_spatial_velocities":
        hand.GetInputPort("body_poses").FixValue(
            context, Value[list[RigidTransform]]([RigidTransform()] * 2)
        )
    with pytest.raises((RuntimeError, ValueError), match=rf"{forgotten}.*human_hand"):
        hand.GetOutputPort("spatial_forces").Eval(context)


def test_plant_that_is_not_finalized_is_refused():
    plant = MultibodyPlant(1e-3)
    with pytest.raises(SystemsError, match=r"Finalize\(\)"):
        HumanHand(plant, grip=plant.world_frame(), X_WB=X_WB, motion=MOTION, R_BE=R_BE)


# A puck of 1 kg on a slide over the board, without gravity or friction.


@pytest.fixture(scope="module")
def sliding_puck():
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(1e-3))
    plant.set_name("plant")
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    sled, puck = (
        plant.AddRigidBody(
            name,
            default_model_instance(),
            SpatialInertia.SolidSphereWithMass(0.5, 0.3),
        )
        for name in ("sled", "puck")
    )
    board = plant.AddFrame(FixedOffsetFrame("board", plant.world_frame(), X_WB))
    plant.AddJoint(
        PlanarJoint("plane", board, sled.body_frame(), damping=[0.0, 0.0, 0.0])
    )
    plant.AddJoint(
        PrismaticJoint(
            "normal", sled.body_frame(), puck.body_frame(), [0, 0, 1], damping=0.0
        )
    )
    plant.Finalize()
    hand = builder.AddSystem(
        HumanHand(
            plant,
            grip=puck.body_frame(),
            X_WB=X_WB,
            motion=MOTION,
            R_BE=RotationMatrix(),
        )
    )
    for name in INPUTS:
        builder.Connect(plant.GetOutputPort(name), hand.GetInputPort(name))
    builder.Connect(
        hand.GetOutputPort("spatial_forces"),
        plant.GetInputPort("applied_spatial_force"),
    )
    logger = LogVectorOutput(hand.GetOutputPort("position"), builder, 0.01)
    logger.set_name("log")
    return builder.Build()


def guided(diagram, seconds=3.5):
    simulator = Simulator(diagram)
    simulator.AdvanceTo(seconds)
    log = diagram.GetSubsystemByName("log").FindLog(simulator.get_context())
    return log.sample_times().copy(), log.data().T.copy()


def test_the_hand_takes_the_tool_along_its_path(sliding_puck):
    times, positions = guided(sliding_puck)
    wanted = np.array([MOTION.at(time)[0] for time in times])
    settled = times > 1.0
    assert np.max(np.abs(positions[:, :2] - wanted)[settled]) < 0.01
    assert np.ptp(wanted[settled], axis=0).min() > 0.1


def test_two_simulations_are_identical(sliding_puck):
    assert_array_equal(guided(sliding_puck, 1.0)[1], guided(sliding_puck, 1.0)[1])


def test_two_interleaved_simulations_do_not_disturb_each_other(sliding_puck):
    _, alone = guided(sliding_puck, 1.0)
    simulators = [Simulator(sliding_puck) for _ in range(2)]
    plant = sliding_puck.GetSubsystemByName("plant")
    # Not both the same.
    plant.SetPositions(
        plant.GetMyMutableContextFromRoot(simulators[1].get_mutable_context()),
        [0.1, 0.1, 0.5, 0.0],
    )
    for time in np.linspace(0.1, 1.0, 10):
        for simulator in simulators:
            simulator.AdvanceTo(time)
    logger = sliding_puck.GetSubsystemByName("log")
    one, two = (logger.FindLog(s.get_context()).data().T for s in simulators)
    assert_array_equal(one, alone)
    assert np.max(np.abs(two - one)) > 0.05


@pytest.mark.parametrize("k", [(0.0, 3.0), (4.0, 4.0), (-3.0, -3.0)])
def test_hand_presses_and_turns_along_the_normal_of_a_curved_board(k):
    surface, time = Surface(*k), 0.5
    hand = make_hand(surface=surface)
    (u, v), rate = MOTION.at(time)
    R_BT = RotationMatrix(rotation(surface, u, v))
    p_BE = place(surface, np.array([[u, v, 0.0]]))[0]
    torque, force, _ = evaluate(hand, RigidTransform(R_BT @ R_BE, p_BE), time=time)
    ahead = place(surface, np.array([[u + 1e-6 * rate[0], v + 1e-6 * rate[1], 0.0]]))[0]
    target_velocity = (ahead - p_BE) / 1e-6

    def damping_and_press(R_BT):
        velocity_T = R_BT.inverse() @ target_velocity
        return np.array([*(DAMPING * velocity_T[:2]), -NORMAL_FORCE])

    assert_allclose(force, R_BT @ damping_and_press(R_BT), atol=1e-3)
    # It turns with the normal along its way.
    later = RotationMatrix(rotation(surface, u + 1e-5 * rate[0], v + 1e-5 * rate[1]))
    turn = (later @ R_BT.inverse()).ToAngleAxis()
    omega = turn.angle() * turn.axis() / 1e-5
    assert_allclose(torque, ROTATIONAL_DAMPING * omega, atol=1e-3)
    # 2 cm behind, the spring pulls along the surface, and not through it.
    behind = place(surface, np.array([[u - 0.02, v, 0.0]]))[0]
    R_BT = RotationMatrix(rotation(surface, u - 0.02, v))
    _, force, _ = evaluate(hand, RigidTransform(R_BT @ R_BE, behind), time=time)
    pull = R_BT.inverse() @ force - damping_and_press(R_BT)
    assert_allclose(pull, [STIFFNESS * 0.02, 0, 0], atol=0.5)
    # Held as on a flat board, it is turned back.
    level, _, _ = evaluate(hand, RigidTransform(R_BE, p_BE), time=time)
    turned = np.hypot(surface.kx * u, surface.ky * v)
    assert np.linalg.norm(level - torque) == pytest.approx(
        ROTATIONAL_STIFFNESS * turned, rel=1e-6
    )


@pytest.mark.parametrize("channels", [("x", "y", "z"), ("x", "y", "rx", "ry", "rz")])
def test_heights_and_orientations_over_a_curved_board_are_refused(channels):
    motion = HandMotion(np.zeros((5, len(channels))), channels)
    make_hand(motion)
    with pytest.raises(SystemsError, match=r"over a curved board the hand follows x"):
        make_hand(motion, surface=Surface(0.0, 3.0))
