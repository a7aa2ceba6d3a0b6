"""Facts about the hand of somebody who drags on the page, at a plant without a page."""

import numpy as np
import pytest
import umsgpack
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.systems.human_hand import hand_torque
from fmp_drake.systems.mouse_hand import (
    MOST_TORQUE,
    SAMPLE_PERIOD,
    TURN_SWITCH,
    MouseHand,
)
from fmp_drake.systems.teaching.mouse_drag import (
    GUIDING_DRAG,
    PULLING_DRAG,
    BoardSurface,
    DragConfig,
)

SPECIFIC = 100.0
MASSES = {1: 0.25, 2: 5.0}
POSE = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.5, 0.1, 0.2])
POINT = [0.01, 0.02, 0.03]
EYE = [1.0, 0.0, 1.5]


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


def pulling(plant, **options):
    return MouseHand(plant, specific_stiffness=SPECIFIC, **options)


def guiding(plant, **options):
    return pulling(
        plant,
        config=GUIDING_DRAG,
        tip=plant.get_body(BodyIndex(2)).body_frame(),
        board=BoardSurface(np.eye(3, 4), np.array([2.0, 2.0])),
        eye=EYE,
        **options,
    )


def spring(body, stretch, velocity=(0, 0, 0)):
    """Return what Drake's spring gives for a stretch, m, and a velocity, m/s."""
    force = ExternallyAppliedSpatialForce()
    force.body_index = BodyIndex(body)
    force.p_BoBq_B = POINT
    away, v = np.array(stretch, dtype=float), np.array(velocity, dtype=float)
    push = MASSES.get(body, 0.0) * (SPECIFIC * away - SPECIFIC**0.5 * v)
    force.F_Bq_W = SpatialForce(np.concatenate([np.zeros(3), push]))
    return force


def say(hand, context, *forces, velocity=(0, 0, 0)):
    """Fix what the page and the plant say."""
    value = Value[list[ExternallyAppliedSpatialForce]](list(forces))
    hand.GetInputPort("spring").FixValue(context, value)
    poses = Value[list[RigidTransform]]([POSE] * 4)
    hand.GetInputPort("body_poses").FixValue(context, poses)
    moving = [SpatialVelocity(np.zeros(3), np.array(velocity, dtype=float))] * 4
    value = Value[list[SpatialVelocity]](moving)
    hand.GetInputPort("body_spatial_velocities").FixValue(context, value)


def begin(hand):
    """Return a simulator after a reading in which nothing was dragged."""
    simulator = Simulator(hand)
    say(hand, simulator.get_mutable_context())
    simulator.AdvanceTo(0.01)
    return simulator


def drag(hand, simulator, *stretches, body=1, seconds=0.016):
    """Drag, and let one reading after the other see it."""
    for stretch in stretches:
        say(hand, simulator.get_mutable_context(), spring(body, stretch))
        simulator.AdvanceTo(simulator.get_context().get_time() + seconds)


def output(hand, simulator, name="spatial_forces"):
    return hand.GetOutputPort(name).Eval(simulator.get_context())


def test_ports_have_names_and_only_the_plant_feeds_through(plant):
    hand = pulling(plant)
    assert hand.get_name() == "mouse_hand"
    inputs = [hand.get_input_port(i).get_name() for i in range(3)]
    assert inputs == ["spring", "body_poses", "body_spatial_velocities"]
    outputs = [hand.get_output_port(i).get_name() for i in range(3)]
    assert outputs == ["spatial_forces", "is_guided", "cursor_interval"]
    fed = [[hand.HasDirectFeedthrough(i, j) for j in range(3)] for i in range(3)]
    assert fed == [[False] * 3, [True, False, False], [True, False, False]]


@pytest.mark.parametrize("body", MASSES)
@pytest.mark.parametrize("caching", [True, False])
def test_every_body_is_pulled_at_its_grabbed_point_with_the_same_stiffness(
    plant, body, caching
):
    hand = pulling(plant)
    simulator = begin(hand)
    if not caching:
        simulator.get_mutable_context().DisableCaching()
    steps = [[0, 0.03 * k / 9, 0.04 * k / 9] for k in range(10)]
    drag(hand, simulator, *steps, steps[-1], steps[-1], body=body)
    (force,) = output(hand, simulator)
    assert int(force.body_index) == body
    assert_allclose(force.p_BoBq_B, POINT)
    assert_allclose(force.F_Bq_W.translational(), [0, 12.0, 16.0], atol=1e-9)
    assert_array_equal(force.F_Bq_W.rotational(), np.zeros(3))


def test_a_body_that_moves_is_pulled_to_the_same_cursor_and_braked(plant):
    hand = pulling(plant)
    simulator = begin(hand)
    v = np.array([0.1, 0.0, 0.0])
    for _ in range(2):
        force = spring(1, [0, 0, 0], v)
        say(hand, simulator.get_mutable_context(), force, velocity=v)
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.016)
    (force,) = output(hand, simulator)
    pulled = force.F_Bq_W.translational()
    assert_allclose(pulled, -PULLING_DRAG.damping * v, atol=1e-9)


def test_a_drag_of_any_body_guides_the_tool_in_its_middle(plant):
    hand = guiding(plant)
    simulator = begin(hand)
    drag(hand, simulator, *[[0, 0.002 * k, 0] for k in range(6)], body=1)
    assert output(hand, simulator, "is_guided")[0] == 1
    (force,) = output(hand, simulator)
    assert int(force.body_index) == 2
    assert_array_equal(force.p_BoBq_B, np.zeros(3))
    x, y, z = force.F_Bq_W.translational()
    assert abs(x) < 1e-9
    assert y > 5
    assert z == pytest.approx(
        -GUIDING_DRAG.normal_force - 0.006 * GUIDING_DRAG.stiffness
    )


def test_a_body_that_must_not_be_dragged_guides_nothing(plant):
    hand = guiding(plant, bodies=[BodyIndex(2)])
    simulator = begin(hand)
    drag(hand, simulator, [0, 0, 0], [0, 0.01, 0], body=1)
    assert output(hand, simulator, "is_guided")[0] == 0
    drag(hand, simulator, [0, 0, 0], [0, 0.01, 0], body=2)
    assert output(hand, simulator, "is_guided")[0] == 1


def test_released_arm_is_held_after_guiding_but_not_after_pulling(plant):
    for make, count in ((guiding, 1), (pulling, 0)):
        hand = make(plant)
        simulator = begin(hand)
        drag(hand, simulator, [0, 0, 0], [0, 0.01, 0])
        say(hand, simulator.get_mutable_context())
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.02)
        forces = output(hand, simulator)
        assert len(forces) == count
        for force in forces:
            # It is above the board, and pressed to it.
            pressed = -GUIDING_DRAG.normal_force - 0.006 * GUIDING_DRAG.stiffness
            assert_allclose(force.F_Bq_W.translational(), [0, 0, pressed], atol=1e-9)


def test_a_drag_that_ended_by_a_jump_begins_anew_after_its_release(plant):
    hand = pulling(plant)
    simulator = begin(hand)
    drag(hand, simulator, [0, 0, 0.01], [0, 0, 0.02])
    assert output(hand, simulator, "is_guided")[0] == 1
    drag(hand, simulator, [0, 0, 2.0], [0, 0, 0.03], [0, 0, 0.04])
    assert output(hand, simulator, "is_guided")[0] == 0
    say(hand, simulator.get_mutable_context())
    simulator.AdvanceTo(simulator.get_context().get_time() + SAMPLE_PERIOD)
    drag(hand, simulator, [0, 0, 0.05], [0, 0, 0.06])
    assert output(hand, simulator, "is_guided")[0] == 1


@pytest.mark.parametrize(
    ("number", "turns"), [(1.0, True), (0.0, False), (np.nan, False)]
)
def test_the_switch_of_the_page_lets_a_drag_turn_the_tool(plant, number, turns):
    meshcat = Meshcat()
    hand = guiding(plant, meshcat=meshcat, R_WE=POSE.rotation())
    simulator = begin(hand)
    assert meshcat.GetSliderNames() == [TURN_SWITCH]
    message = {"type": "slider", "name": TURN_SWITCH, "value": number}
    meshcat._InjectWebsocketMessage(umsgpack.packb(message))
    drag(hand, simulator, *[[0, 0.002 * k, 0] for k in range(6)], body=2)
    (force,) = output(hand, simulator)
    pulled = np.linalg.norm(force.F_Bq_W.translational()[:2])
    turned = np.linalg.norm(force.F_Bq_W.rotational())
    assert (turned > 0.5, pulled > 0.5) == (turns, not turns)
    # The next simulation begins with the switch turned off.
    begin(guiding(plant, meshcat=meshcat, R_WE=POSE.rotation()))
    assert meshcat.GetSliderValue(TURN_SWITCH) == 0


def test_a_tool_that_was_turned_is_held_at_its_orientation(plant):
    R = RotationMatrix(RollPitchYaw(0.0, 0.0, 0.1)) @ POSE.rotation()
    hand = guiding(plant, R_WE=R)
    simulator = Simulator(hand)
    say(hand, simulator.get_mutable_context())
    simulator.AdvanceTo(0.01)
    (force,) = output(hand, simulator)
    # It begins with the way it is held, and not with a jump.
    assert_allclose(force.F_Bq_W.rotational(), np.zeros(3), atol=1e-9)


def test_the_interval_of_the_pages_pictures_is_known(plant):
    hand = guiding(plant)
    simulator = begin(hand)
    drag(hand, simulator, *[[0, 0.003 * k, 0] for k in range(20)], seconds=0.096)
    interval = output(hand, simulator, "cursor_interval")[0]
    assert interval == pytest.approx(0.096, abs=0.001)


def test_mouse_is_sampled_at_a_rate_and_the_sample_is_the_state(plant):
    hand = pulling(plant)
    simulator = begin(hand)
    drag(hand, simulator, [0, 0, 0.01], seconds=0.25 * SAMPLE_PERIOD)
    assert output(hand, simulator) == []
    drag(hand, simulator, [0, 0, 0.01], seconds=0.25 * SAMPLE_PERIOD)
    assert len(output(hand, simulator)) == 1
    copy = simulator.get_context().Clone()
    assert len(hand.GetOutputPort("spatial_forces").Eval(copy)) == 1


def test_cloned_context_of_a_drag_continues_identically(plant):
    hand = guiding(plant)
    simulator = begin(hand)
    drag(hand, simulator, [0, 0, 0], [0, 0.01, 0])
    copy = Simulator(hand, simulator.get_context().Clone())
    for each in (simulator, copy):
        drag(hand, each, [0, 0.02, 0], [0, 0.03, 0])
    (one,), (other,) = output(hand, simulator), output(hand, copy)
    assert_array_equal(one.F_Bq_W.get_coeffs(), other.F_Bq_W.get_coeffs())


@pytest.mark.parametrize(
    "force", [spring(3, [0.1, 0, 0]), spring(1, [np.nan, 0, 0])], ids=["ghost", "nan"]
)
def test_bodies_without_mass_and_invalid_forces_are_ignored(plant, force):
    hand = pulling(plant)
    simulator = begin(hand)
    say(hand, simulator.get_mutable_context(), force)
    simulator.AdvanceTo(0.05)
    assert output(hand, simulator) == []


def test_a_forgotten_input_is_named(plant):
    with pytest.raises(RuntimeError, match=r"spring.*mouse_hand"):
        Simulator(pulling(plant)).AdvanceTo(0.1)


def test_values_that_do_not_fit_are_refused(plant):
    with pytest.raises(SystemsError, match="may be turned needs a tip"):
        pulling(plant, R_WE=RotationMatrix())
    with pytest.raises(SystemsError, match="a tip and a board"):
        pulling(plant, board=BoardSurface(np.eye(3, 4), np.ones(2)))
    for stiffness in (0.0, np.nan):
        with pytest.raises(SystemsError, match="specific_stiffness is"):
            MouseHand(plant, specific_stiffness=stiffness)
    with pytest.raises(SystemsError, match="damping is nan"):
        pulling(plant, config=DragConfig(damping=np.nan))
    with pytest.raises(SystemsError, match=r"Finalize\(\)"):
        MouseHand(MultibodyPlant(0.001), specific_stiffness=1.0)


def test_torque_of_the_hand_is_limited():
    def torque(away, velocity):
        R = RotationMatrix(Rotation.from_rotvec(away).as_matrix())
        return hand_torque(R, velocity, MOST_TORQUE)

    away, still = np.array([0.0, 0.1, 0.0]), np.zeros(3)
    assert_allclose(torque(away, still), [0, 6, 0])
    assert_allclose(torque(still, away), [0, -0.6, 0])
    assert_allclose(torque(10 * away, still), [0, 15, 0])
