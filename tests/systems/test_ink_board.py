"""Facts about the ink that an eraser wears off a board in simulation.

A box eraser of the size of the felt is pressed on the board by its weight, and
slides without friction at the velocity it starts with.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from rubbed_board import (
    FELT,
    GRID,
    INPUTS,
    MODULUS,
    OUTPUTS,
    PERIOD,
    add_ink,
    make_plant,
)

from fmp_drake.errors import SystemsError
from fmp_drake.systems.erase_times import NEVER, EraseTimes
from fmp_drake.systems.ink.grid import CLEAN_BELOW, cleaned_history
from fmp_drake.systems.ink.rubbing import LONGEST_STEP, STRIPE_PITCH, WEAR_CONSTANT
from fmp_drake.systems.ink_board import InkBoard


@dataclass(frozen=True)
class Scene:
    diagram: Diagram
    plant: MultibodyPlant
    board: InkBoard
    erased: EraseTimes | None = None

    def start(self, *, p=(0.0, 0.0), v=(0.0, 0.0), z=-0.002, spin=0.0, board=0.0):
        """Make a simulator; p in m, v in m/s and the felt's height z in B."""
        simulator = Simulator(self.diagram)
        context = self.plant.GetMyMutableContextFromRoot(
            simulator.get_mutable_context()
        )
        for name, q, rate in (
            ("slide", 0.0, board),
            ("x", p[0], v[0]),
            ("y", p[1], v[1]),
            ("z", z, 0.0),
        ):
            joint = self.plant.GetJointByName(name)
            joint.set_translation(context, q)
            joint.set_translation_rate(context, rate)
        self.plant.GetJointByName("yaw").set_angular_rate(context, spin)
        return simulator

    def value(self, simulator, name):
        context = self.board.GetMyContextFromRoot(simulator.get_context())
        return self.board.GetOutputPort(name).Eval(context)

    def ink(self, simulator):
        return self.value(simulator, "ink").reshape(self.board.grid.shape)

    def erase_time(self, simulator):
        context = self.erased.GetMyContextFromRoot(simulator.get_context())
        port = self.erased.GetOutputPort("erase_time")
        return port.Eval(context).reshape(self.board.grid.shape)


def make_scene(*, force=10.0, eraser_first=False, **options):
    builder = DiagramBuilder()
    plant, eraser, surface = make_plant(builder, force=force, eraser_first=eraser_first)
    board = add_ink(builder, plant, eraser, surface, **options)
    erased = EraseTimes(initial_ink=board.initial_ink, period=PERIOD)
    builder.AddSystem(erased)
    builder.Connect(board.GetOutputPort("ink"), erased.get_input_port())
    return Scene(builder.Build(), plant, board, erased)


@pytest.fixture(scope="module")
def scene():
    return make_scene()


def strip(y_low, y_high):
    """Cells with centres under the felt's width from y_low to y_high."""
    x, y = GRID.centres.reshape(*GRID.shape, 2).transpose(2, 0, 1)
    return (np.abs(x) < 0.06) & (y > y_low) & (y < y_high)


def squeeze(scene, simulator):
    """Depth (m) to which the eraser sinks in and the pressure (Pa) in its middle."""
    context = scene.plant.GetMyContextFromRoot(simulator.get_context())
    depth = -scene.plant.GetJointByName("z").get_translation(context)
    return depth, MODULUS * depth / 0.015


def test_ports_have_names_and_sizes(scene):
    board = scene.board
    assert board.get_name() == "ink_board"
    assert [
        board.get_input_port(i).get_name() for i in range(board.num_input_ports())
    ] == INPUTS
    assert [
        board.get_output_port(i).get_name() for i in range(board.num_output_ports())
    ] == OUTPUTS
    sizes = [board.GetOutputPort(name).size() for name in OUTPUTS]
    assert sizes == [GRID.num_cells] + [1] * 3


def test_only_force_and_area_feed_through(scene):
    table = [
        [scene.board.HasDirectFeedthrough(i, j) for j in range(len(OUTPUTS))]
        for i in range(len(INPUTS))
    ]
    state = [False] * 2
    assert table == [[*state, True, True], [*state, True, False], [False] * 4]


@pytest.mark.parametrize("eraser_first", [False, True])
def test_a_stroke_cleans_the_swept_strip_and_nothing_else(eraser_first):
    scene = make_scene(eraser_first=eraser_first)
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.2))
    simulator.AdvanceTo(1.021)
    ink = scene.ink(simulator)
    path = np.array([[0.0, -0.1, -0.002], [0.0, 0.1042, -0.002]])
    swept = GRID.swept_area(path, FELT)
    assert (ink[~swept] == 1.0).all()
    # The felt has passed over these with its whole length.
    assert (ink[strip(-0.075, 0.075)] < 0.05).all()
    assert (ink[strip(-0.12, 0.12)] < 1.0).all()
    fraction = scene.value(simulator, "cleaned_fraction")[0]
    assert fraction == np.mean(ink < 0.1)
    # Two rows at either end have felt the felt for less than half its length.
    assert fraction == pytest.approx(0.12 * 0.2 / (0.4 * 0.3), rel=0.06)


def test_both_orders_of_the_contact_pair_are_tested():
    orders = set()
    for eraser_first in (False, True):
        scene = make_scene(eraser_first=eraser_first)
        simulator = scene.start()
        simulator.AdvanceTo(0.01)
        results = scene.plant.get_contact_results_output_port().Eval(
            scene.plant.GetMyContextFromRoot(simulator.get_context())
        )
        surface = results.hydroelastic_contact_info(0).contact_surface()
        eraser = scene.plant.GetCollisionGeometriesForBody(
            scene.plant.GetBodyByName("eraser")
        )
        orders.add(surface.id_M() in eraser)
        assert scene.value(simulator, "normal_force")[0] > 5.0
    assert orders == {False, True}


@pytest.mark.parametrize("speed", [0.05, 1.0])
def test_ink_after_a_stroke_follows_the_wear_law_at_any_speed(speed):
    scene = make_scene()
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, speed))
    simulator.AdvanceTo(0.2 / speed)
    middle = scene.ink(simulator)[25:35, 30:50]
    # A compliant box of half height 15 mm that is squeezed by `depth` bears
    # `pressure`, except within `depth` of its edges, where it falls to zero.
    depth, pressure = squeeze(scene, simulator)
    felt = pressure * (FELT[1] - depth)
    resolution = min(speed * PERIOD, LONGEST_STEP) * pressure
    exposure = -WEAR_CONSTANT * np.log(middle)
    assert exposure.mean() == pytest.approx(felt, abs=0.02 * felt + 0.5 * resolution)
    assert np.ptp(exposure) <= 0.02 * felt + 1.01 * resolution


def test_no_sliding_wears_nothing(scene):
    simulator = scene.start()
    simulator.AdvanceTo(0.3)
    assert scene.value(simulator, "normal_force")[0] > 9.0
    assert scene.ink(simulator).min() > 1.0 - 1e-6
    assert scene.value(simulator, "cleaned_fraction")[0] == 0.0


def test_no_contact_wears_nothing(scene):
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 1.0), z=0.3)
    simulator.AdvanceTo(0.2)
    assert (scene.ink(simulator) == 1.0).all()
    assert scene.value(simulator, "normal_force")[0] == 0.0
    assert scene.value(simulator, "contact_area")[0] == 0.0


def test_moving_along_with_the_board_wears_nothing(scene):
    simulator = scene.start(v=(0.3, 0.0), board=0.3)
    simulator.AdvanceTo(0.3)
    assert scene.value(simulator, "normal_force")[0] > 5.0
    assert scene.ink(simulator).min() > 1.0 - 1e-6


def test_a_sliding_board_is_wiped_by_a_resting_eraser(scene):
    simulator = scene.start(p=(0.1, 0.0), board=0.3)
    simulator.AdvanceTo(0.5)
    ink = scene.ink(simulator)
    path = np.array([[0.1, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    swept = GRID.swept_area(path, FELT)
    assert (ink[~swept] == 1.0).all()
    assert ink[30, 35] < 0.05


def test_spinning_in_place_wears_the_outside_but_not_the_centre(scene):
    simulator = scene.start(spin=1.0)
    simulator.AdvanceTo(0.601)
    ink = scene.ink(simulator)
    _, pressure = squeeze(scene, simulator)
    r = np.hypot(*GRID.centres.T).reshape(GRID.shape)
    under = r < 0.5 * FELT[1] - 0.003
    exposure = -WEAR_CONSTANT * np.log(ink[under])
    np.testing.assert_allclose(exposure, pressure * r[under] * 0.6, rtol=0.03)
    assert (ink[r > 0.5 * np.hypot(*FELT) + 1e-3] == 1.0).all()


@pytest.mark.parametrize("force", [3.0, 10.0, 15.0])
def test_normal_force_equals_the_applied_force(force):
    scene = make_scene(force=force)
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.2))
    simulator.AdvanceTo(0.5)
    assert scene.value(simulator, "normal_force")[0] == pytest.approx(force, rel=0.01)
    area = scene.value(simulator, "contact_area")[0]
    assert area == pytest.approx(FELT[0] * FELT[1], rel=0.01)


def test_ink_that_is_not_there_is_not_counted():
    initial = np.zeros(GRID.shape)
    initial[25:35, 30:50] = 0.5
    scene = make_scene(initial_ink=initial)
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.4))
    assert scene.value(simulator, "cleaned_fraction")[0] == 0.0
    np.testing.assert_array_equal(scene.ink(simulator), initial)
    simulator.AdvanceTo(0.5)
    assert scene.value(simulator, "cleaned_fraction")[0] == 1.0
    assert (scene.ink(simulator)[initial == 0.0] == 0.0).all()
    never = scene.erase_time(simulator) == NEVER
    np.testing.assert_array_equal(never, initial == 0.0)


def test_erase_time_follows_the_eraser(scene):
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.2))
    assert (scene.erase_time(simulator) == NEVER).all()
    simulator.AdvanceTo(1.0)
    ink = scene.ink(simulator)
    _, pressure = squeeze(scene, simulator)
    y = GRID.centres.reshape(*GRID.shape, 2)[25:35, 40, 1]
    time = scene.erase_time(simulator)
    np.testing.assert_array_equal(time < NEVER, ink < CLEAN_BELOW)
    # The leading edge gets to y after (y + 0.075) / v; then a length of felt
    # must pass, and 1 mm of its soft edge. Half a period comes on top on average.
    felt = -WEAR_CONSTANT * np.log(CLEAN_BELOW) / pressure + 0.001
    expected = (y + 0.075 + felt) / 0.2 + 0.5 * PERIOD
    np.testing.assert_allclose(time[25:35, 40], expected, atol=0.5 * PERIOD + 0.01)


def test_weak_ink_wears_and_has_no_erase_time():
    scene = make_scene(initial_ink=np.full(GRID.shape, 0.05))
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.4))
    assert scene.value(simulator, "cleaned_fraction")[0] == 1.0
    simulator.AdvanceTo(0.5)
    assert (scene.erase_time(simulator) == NEVER).all()
    assert (scene.ink(simulator) < 0.01).any()


def test_the_history_from_erase_times_is_the_cleaned_fraction(scene):
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.2))
    times = np.arange(1, 12) * 0.08 + 0.001
    seen = []
    for t in times:
        simulator.AdvanceTo(t)
        seen.append(scene.value(simulator, "cleaned_fraction")[0])
    erased = scene.erase_time(simulator)
    everywhere = np.ones(GRID.num_cells, dtype=bool)
    np.testing.assert_allclose(cleaned_history(erased, everywhere, times), seen)
    assert seen[-1] > 0.1


def test_an_update_leaves_its_context_alone(scene):
    simulator = scene.start(v=(0.0, 0.2))
    simulator.AdvanceTo(2.0 * PERIOD)
    context = scene.board.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    groups = range(context.num_discrete_state_groups())
    before = [context.get_discrete_state(i).value().copy() for i in groups]
    updated = scene.board.EvalUniquePeriodicDiscreteUpdate(context)
    for i in groups:
        np.testing.assert_array_equal(context.get_discrete_state(i).value(), before[i])
    assert any(not np.array_equal(updated.value(i), before[i]) for i in groups)


@pytest.fixture(scope="module")
def two_periods():
    """A scene with two boards: a period of 2 ms, and the default."""
    builder = DiagramBuilder()
    parts = make_plant(builder)
    fine = add_ink(builder, *parts, period=0.002)
    fine.set_name("fine")
    coarse = add_ink(builder, *parts)
    return Scene(builder.Build(), parts[0], fine), coarse


def error_of_the_period(two_periods, simulator):
    """Root mean square of the difference that the default period makes."""
    scene, coarse = two_periods
    fine = scene.ink(simulator)
    context = coarse.GetMyContextFromRoot(simulator.get_context())
    other = coarse.GetOutputPort("ink").Eval(context).reshape(GRID.shape)
    assert np.count_nonzero(fine < 0.5) > 400
    return np.sqrt(np.mean((fine - other) ** 2))


def test_the_period_hardly_changes_the_ink_that_is_wiped(two_periods):
    simulator = two_periods[0].start(p=(0.03, -0.1), v=(-0.1, 0.4), spin=0.2)
    simulator.AdvanceTo(0.4505)
    assert error_of_the_period(two_periods, simulator) < 0.003


@pytest.mark.parametrize("height", [0.002, 0.006, 0.01])
def test_the_period_hardly_changes_the_ink_where_an_eraser_lands(two_periods, height):
    simulator = two_periods[0].start(p=(0.03, -0.12), v=(0.0, 0.4), z=height)
    simulator.AdvanceTo(0.4505)
    assert error_of_the_period(two_periods, simulator) < 0.02


@pytest.mark.parametrize("moment", [0.2005, 0.2205, 0.2405])
def test_the_period_hardly_changes_the_ink_where_an_eraser_is_lifted(
    two_periods, moment
):
    scene, _ = two_periods
    simulator = scene.start(p=(0.03, -0.1), v=(0.0, 0.4))
    lift = scene.plant.GetJointByName("z")
    # Upward at 10 m/s^2.
    for i in range(80):
        simulator.AdvanceTo(moment + 0.001 * i)
        context = scene.plant.GetMyMutableContextFromRoot(
            simulator.get_mutable_context()
        )
        lift.set_translation_rate(context, 0.01 * i)
    simulator.AdvanceTo(0.3505)
    assert scene.value(simulator, "normal_force")[0] == 0.0
    assert error_of_the_period(two_periods, simulator) < 0.02


def test_contact_surfaces_of_triangles_wear_the_same_ink():
    inks = []
    for faces in ("polygon", "triangle"):
        builder = DiagramBuilder()
        parts = make_plant(builder, faces=faces)
        board = add_ink(builder, *parts)
        scene = Scene(builder.Build(), parts[0], board)
        simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.4))
        simulator.AdvanceTo(0.3)
        inks.append(scene.ink(simulator))
    np.testing.assert_allclose(*inks, atol=0.01)
    assert inks[0].min() < 0.05


def test_a_run_may_start_between_two_periods(scene):
    left = []
    for begin in (0.0, 0.3217):
        simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.4))
        simulator.get_mutable_context().SetTime(begin)
        simulator.AdvanceTo(begin + 0.3)
        left.append(scene.ink(simulator)[20:26, 30:50])
    assert left[0].mean() < 0.1
    np.testing.assert_allclose(left[1], left[0], atol=0.02)


@pytest.mark.parametrize("worn", [0.0, 0.3, 0.6])
def test_a_worn_felt_leaves_stripes_where_it_has_gone(worn):
    scene = make_scene(worn=worn)
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.2))
    simulator.AdvanceTo(1.0)
    middle = scene.ink(simulator)[25:35, 28:52]
    across = GRID.x[28:52] / STRIPE_PITCH
    gone = 2.0 * np.abs(across - np.rint(across)) < worn
    assert (middle[:, gone] == 1.0).all()
    assert (middle[:, ~gone] < 0.05).all()
    # Cells of 5 mm cannot show stripes every 20 mm better.
    assert np.mean(gone) == pytest.approx(worn, abs=0.21)
    assert scene.value(simulator, "normal_force")[0] == pytest.approx(10.0, rel=0.01)


def test_a_worn_felt_wiped_along_its_length_cleans_all_but_slower():
    left = []
    for worn in (0.0, 0.5):
        scene = make_scene(worn=worn)
        simulator = scene.start(p=(-0.1, 0.0), v=(0.4, 0.0))
        simulator.AdvanceTo(0.481)
        left.append(scene.ink(simulator)[28:32, 36:44])
    assert left[0].max() < 1e-3
    # Half of the exposure: the square root of the ink.
    np.testing.assert_allclose(np.log(left[1]), 0.5 * np.log(left[0]), rtol=0.12)


def test_a_felt_that_has_gone_cleans_next_to_nothing():
    scene = make_scene(worn=1.0)
    simulator = scene.start(p=(0.0, -0.1), v=(0.0, 0.2))
    simulator.AdvanceTo(1.0)
    assert scene.ink(simulator).mean() > 0.99


def test_looking_at_the_ink_changes_nothing(scene):
    seen, unseen = (scene.start(v=(0.0, 0.2)) for _ in range(2))
    for t in np.arange(1, 60) * 0.01:
        seen.AdvanceTo(t)
        scene.ink(seen)
    unseen.AdvanceTo(0.59)
    for name in OUTPUTS:
        np.testing.assert_array_equal(
            scene.value(seen, name), scene.value(unseen, name)
        )
    assert scene.ink(unseen).min() < 0.5


def test_ink_is_worn_in_every_period(scene):
    simulator = scene.start(v=(0.0, 0.2))
    left = []
    for k in range(1, 10):
        simulator.AdvanceTo(k * PERIOD + 0.0005)
        left.append(scene.ink(simulator).sum())
    assert np.all(np.diff(left) < -10)


def test_two_interleaved_simulations_do_not_disturb_each_other(scene):
    starts = [{"v": (0.0, 0.2)}, {"p": (0.05, 0.0), "v": (0.2, 0.0)}]
    alone = []
    for start in starts:
        simulator = scene.start(**start)
        simulator.AdvanceTo(0.2)
        alone.append(scene.ink(simulator).copy())
    assert not np.array_equal(*alone)
    simulators = [scene.start(**start) for start in starts]
    for t in np.arange(1, 21) * 0.01:
        for simulator in simulators:
            simulator.AdvanceTo(t)
    for simulator, expected in zip(simulators, alone, strict=True):
        np.testing.assert_array_equal(scene.ink(simulator), expected)


def test_a_copied_context_carries_on_with_the_identical_run(scene):
    simulator = scene.start(p=(0.0, -0.05), v=(0.0, 0.2))
    copies = []
    for t in (0.0004, 0.0213, 0.05, 0.0774, 0.1055, 0.15):
        simulator.AdvanceTo(t)
        scene.ink(simulator)
        copies.append(Simulator(scene.diagram, simulator.get_context().Clone()))
    early = scene.ink(simulator).copy()
    simulator.AdvanceTo(0.22)
    np.testing.assert_array_equal(scene.ink(copies[-1]), early)
    for copy in copies:
        copy.AdvanceTo(0.22)
        for name in OUTPUTS:
            np.testing.assert_array_equal(
                scene.value(copy, name), scene.value(simulator, name)
            )
    assert not np.array_equal(scene.ink(simulator), early)


def test_caching_changes_nothing(scene):
    values = []
    for caching in (True, False):
        simulator = scene.start(v=(0.0, 0.2))
        if not caching:
            simulator.get_mutable_context().DisableCaching()
        seen = []
        for t in (0.0, 0.03, 0.1):
            simulator.AdvanceTo(t)
            seen.append(
                np.concatenate([scene.value(simulator, name) for name in OUTPUTS])
            )
        values.append(seen)
    np.testing.assert_array_equal(*values)
    assert not np.array_equal(values[0][0], values[0][2])


@pytest.mark.parametrize("missing", INPUTS)
def test_a_forgotten_input_is_named(missing):
    builder = DiagramBuilder()
    plant, eraser, surface = make_plant(builder)
    inputs = [name for name in INPUTS if name != missing]
    board = add_ink(builder, plant, eraser, surface, inputs=inputs)
    scene = Scene(builder.Build(), plant, board)
    simulator = scene.start(v=(0.0, 0.2))
    with pytest.raises((RuntimeError, ValueError), match=f"{missing}.*ink_board"):
        simulator.AdvanceTo(0.1)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"initial_ink": np.ones((3, 4))}, r"shape \(3, 4\).*\(60, 80\)"),
        ({"initial_ink": np.full(GRID.shape, 2.0)}, "from 2.0 to 2.0"),
        ({"initial_ink": np.full(GRID.shape, np.nan)}, "fractions from 0 to 1"),
        ({"period": np.nan}, "period is nan"),
        ({"worn": 1.5}, "worn is 1.5"),
        ({"worn": np.nan}, "worn is nan"),
    ],
)
def test_bad_parameters_are_refused(options, what):
    builder = DiagramBuilder()
    plant, eraser, surface = make_plant(builder)
    with pytest.raises(SystemsError, match=what):
        add_ink(builder, plant, eraser, surface, **options)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"eraser": "felt"}, "eraser is 'felt'; its type must be Frame"),
        ({"grid": (0.3, 0.4)}, r"grid is \(0.3, 0.4\); its type must be InkGrid"),
    ],
)
def test_an_argument_of_another_type_is_refused_with_the_expected_one(options, what):
    plant, eraser, surface = make_plant(DiagramBuilder())
    frames = {"eraser": eraser.body_frame(), "surface": surface, "grid": GRID}
    with pytest.raises(SystemsError, match=what):
        InkBoard(plant=plant, **(frames | options))


@pytest.mark.parametrize("name", ["eraser", "surface"])
def test_a_frame_of_another_plant_is_refused(name):
    plant, eraser, surface = make_plant(DiagramBuilder())
    other, _, _ = make_plant(DiagramBuilder())
    frames = {"eraser": eraser.body_frame(), "surface": surface}
    frames[name] = other.get_frame(frames[name].index())
    with pytest.raises(SystemsError, match=f"{name} .* is a frame of another plant"):
        InkBoard(plant=plant, grid=GRID, **frames)


def test_an_eraser_on_the_body_of_the_board_is_refused():
    builder = DiagramBuilder()
    plant, eraser, _ = make_plant(builder)
    with pytest.raises(SystemsError, match=f"are both on the body '{eraser.name()}'"):
        add_ink(builder, plant, eraser, eraser.body_frame())


def test_a_body_that_cannot_touch_is_refused():
    builder = DiagramBuilder()
    plant, _, surface = make_plant(builder)
    ghost = plant.GetBodyByName("carriage_x")
    with pytest.raises(SystemsError, match="'carriage_x' has no collision geometry"):
        add_ink(builder, plant, ghost, surface)
