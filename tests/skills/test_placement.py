"""Facts about placing a demonstration on a board."""

from dataclasses import replace

import numpy as np
import pytest
import recorded_files as files
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import (
    Demonstration,
    ReadingOptions,
    add_orientation,
    find_rhythm,
)
from fmp_drake.skills.contact import samples_in_bouts
from fmp_drake.skills.joint_recording import RobotJoints
from fmp_drake.skills.loading import load_as_recorded, load_on_board
from fmp_drake.skills.placement import (
    Placement,
    check_width,
    fit_placement,
    place_on_board,
)
from fmp_drake.station import Scenario

USABLE = (0.4, 0.3)


def strokes(count=600, lift=0.1, noise=0.001, size=1.0):
    """Return a path (N, 3) that wipes z = 0, and is lifted a third of the time."""
    t = np.linspace(0, 12, count)
    rng = np.random.default_rng(0)
    height = noise * rng.standard_normal(count)
    height += lift * np.clip(np.sin(2 * np.pi * t / 4) - 0.5, 0, None)
    return np.column_stack(
        [0.15 * size * np.sin(3 * t), 0.1 * size * np.cos(2 * t + 0.3), height]
    )


def demonstration(values):
    return Demonstration(time=np.arange(len(values)) / 50, values=values, frame="base")


@settings(deadline=None, max_examples=25)
@given(
    rotvec=st.tuples(*[st.floats(-1.5, 1.5)] * 3),
    shift=st.tuples(*[st.floats(-1, 1)] * 3),
)
def test_path_in_any_frame_is_placed_flat_in_the_middle(rotvec, shift):
    turn = Rotation.from_rotvec(rotvec).as_matrix()
    path = strokes() @ turn.T + shift
    placement = fit_placement(demonstration(path), usable=(0.6, 0.6))
    placed_path = placement.apply(demonstration(path))
    assert placed_path.frame == "board"
    assert placement.scale == 1.0
    x, y, z = placed_path.values.T
    assert x.min() + x.max() == pytest.approx(0, abs=1e-9)
    assert y.min() + y.max() == pytest.approx(0, abs=1e-9)
    # Lifted a third of the time, by up to 5 cm less the touch of 1 cm, and upwards.
    assert np.all(z >= 0)
    assert z.max() == pytest.approx(0.04, abs=0.004)
    assert np.mean(z == 0) == pytest.approx(placement.touching)
    assert placement.touching == pytest.approx(0.71, abs=0.06)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_only_what_is_learned_is_placed_and_the_approach_shows_the_free_side(side):
    t = np.arange(0, 40, 0.05)
    ellipse = np.column_stack([0.1 * np.cos(2 * t), 0.06 * np.sin(2 * t), 0 * t])
    way = np.linspace([0.9, 0.5, 0.4 * side], ellipse[0], 60)
    path = np.concatenate([way, ellipse])
    path[400] += [0.3, 0.0, 0.0]  # A sample that the tracker has lost.
    placement = fit_placement(demonstration(path), usable=USABLE)
    assert placement.scale == 1
    assert placement.touching > 0.97
    placed = placement.apply(demonstration(path)).values
    kept = np.delete(placed[60:], 340, axis=0)
    middle = (kept.min(axis=0) + kept.max(axis=0)) / 2
    np.testing.assert_allclose(middle, 0, atol=0.01)
    assert placed[0, 2] > 0.3


@settings(deadline=None, max_examples=25)
@given(rotvec=st.tuples(*[st.floats(-1.5, 1.5)] * 3))
def test_placement_is_a_rotation_that_keeps_x_in_front(rotvec):
    path = strokes() @ Rotation.from_rotvec(rotvec).as_matrix().T
    r = fit_placement(demonstration(path), usable=USABLE).rotation
    assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1)
    # A steep plane that faces -x has its upper end in front.
    forward, sign = (2, -np.sign(r[2, 0])) if abs(r[2, 0]) > 0.9 else (0, 1.0)
    assert r[1, forward] == pytest.approx(0, abs=1e-12)
    assert sign * r[0, forward] > 0


def test_flat_path_lies_with_its_normal_up():
    path = strokes(lift=0, noise=0)
    r = fit_placement(demonstration(path), usable=USABLE).rotation
    assert_allclose(r, np.eye(3), atol=1e-9)


def test_path_that_is_too_large_is_scaled_down():
    path = demonstration(strokes(size=2.0))
    placement = fit_placement(path, usable=USABLE)
    assert placement.scale == pytest.approx(0.4 / 0.6, rel=0.01)
    extent = np.ptp(placement.apply(path).values, axis=0)
    assert extent[0] == pytest.approx(0.4, rel=1e-6)
    assert extent[1] <= 0.3
    # The touch shrinks with it.
    assert placement.touch == pytest.approx(0.01 * placement.scale)


def test_only_the_part_that_is_learned_is_placed():
    """A movement of another size beside it neither scales nor moves it."""
    time = np.arange(0, 40, 0.02)
    radius, middle = np.where(time < 20, [[0.1], [0.0]], [[0.4], [1.0]])
    path = np.column_stack(
        [
            radius * np.cos(4 * time) + middle,
            radius * np.sin(4 * time),
            np.zeros(len(time)),
        ]
    )
    recording = demonstration(path)
    placement = fit_placement(recording, usable=USABLE, start_time=1.0, end_time=18.0)
    assert placement.scale == 1
    placed = placement.apply(recording).values[(time > 2) & (time < 17)]
    assert_allclose((placed.min(axis=0) + placed.max(axis=0)) / 2, 0, atol=0.002)
    with pytest.raises(DemonstrationError, match="no two samples from 50 s"):
        fit_placement(recording, usable=USABLE, start_time=50.0)


def test_apply_is_the_documented_similarity():
    r = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    placement = Placement(rotation=r, translation=np.array([0.1, 0.2, 0.3]), scale=0.5)
    path = demonstration(strokes())
    placed_path = placement.apply(path)
    expected = [0.5 * r @ p + [0.1, 0.2, 0.3] for p in path.values]
    assert_allclose(placed_path.values, expected, atol=1e-12)
    assert np.array_equal(placed_path.time, path.time)


def test_heights_are_kept_without_a_touch():
    placement = Placement(rotation=np.eye(3), translation=np.zeros(3))
    path = demonstration(strokes())
    assert np.array_equal(placement.apply(path).values, path.values)


def test_placement_repeats():
    path = demonstration(strokes())
    one, two = (fit_placement(path, usable=USABLE) for _ in range(2))
    assert np.array_equal(one.rotation, two.rotation)
    assert np.array_equal(one.translation, two.translation)


def test_long_recordings_are_placed_in_little_memory_and_time():
    # Half an hour at 100 Hz.
    time = np.arange(180_000) / 100
    height = 0.001 * np.random.default_rng(0).standard_normal(len(time))
    path = np.column_stack([0.15 * np.sin(3 * time), 0.1 * np.cos(3 * time), height])
    placement = fit_placement(Demonstration(time=time, values=path), usable=USABLE)
    assert_allclose(placement.rotation, np.eye(3), atol=0.01)
    assert placement.scale == 1


def test_apply_keeps_the_recording_and_its_note():
    path = Demonstration(time=np.arange(600), values=strokes(), note="of someone")
    before = path.values.copy()
    placed_path = fit_placement(path, usable=USABLE).apply(path)
    assert np.array_equal(path.values, before)
    assert placed_path.note == "of someone"
    assert placed_path.channels == ("x", "y", "z")


def test_path_on_a_wall_is_placed_on_the_board():
    # y and z span the wall; the tool leaves it towards the robot, along -x.
    path = demonstration([0.6, 0.0, 0.5] - strokes(noise=0)[:, [2, 1, 0]])
    placement = fit_placement(path, usable=USABLE)
    assert_allclose(placement.rotation[2], [-1, 0, 0], atol=0.05)
    assert_allclose(placement.rotation[0], [0, 0, 1], atol=0.05)  # Upwards.
    assert placement.apply(path).values[:, 2].max() == pytest.approx(0.04, abs=0.004)
    _, remarks = place_on_board(path, scenario=Scenario())
    assert "by its plane (tilted by 90 degrees in the recording), at" in remarks[-1]
    _, remarks = place_on_board(demonstration(strokes()), scenario=Scenario())
    assert "tilted" not in remarks[-1]


@pytest.mark.parametrize("noise", [0.001, 0.003])
def test_path_of_an_unsteady_hand_is_placed_level(noise):
    path = strokes(lift=0.3, noise=noise)
    normal = fit_placement(demonstration(path), usable=USABLE).rotation[2]
    assert np.degrees(np.arccos(normal[2])) < 2


@pytest.mark.parametrize("size", [1e-4, 1e-2, 1.0, 100.0])
def test_a_line_is_recognised_by_its_shape_at_any_size(size):
    t = np.linspace(0, 6, 200)
    line = np.column_stack([np.sin(t), 1e-4 * np.cos(5 * t), 0 * t])
    circle = np.column_stack([np.sin(t), np.cos(t), 0 * t])
    fit_placement(demonstration(size * circle), usable=USABLE)
    with pytest.raises(DemonstrationError, match="a point or a line"):
        fit_placement(demonstration(size * line), usable=USABLE)


@pytest.mark.parametrize("channels", [2, 4])
def test_path_without_3_channels_is_refused(channels):
    with pytest.raises(DemonstrationError, match=f"has {channels} channels"):
        fit_placement(demonstration(np.zeros((9, channels))), usable=USABLE)


@pytest.mark.parametrize(
    "path", [np.zeros((9, 3)), np.outer(np.arange(9.0), [1.0, 2.0, 3.0])]
)
def test_path_on_a_point_or_a_line_is_refused(path):
    with pytest.raises(DemonstrationError, match="its plane is not determined"):
        fit_placement(demonstration(path), usable=USABLE)


@pytest.mark.parametrize(
    ("width", "advice"),
    [
        (300, r"300 m wide: millimetres\? Give --unit mm"),
        (20, r"20 m wide: centimetres\? Give --unit cm"),
        (1e6, r"1e\+06 m wide: check its unit"),
        (1e-3, r"0\.001 m wide: check its unit"),
    ],
)
def test_path_that_no_arm_can_follow_is_refused_with_a_guess(width, advice):
    path = demonstration(np.linspace(0, 1, 9)[:, None] * [width, 0.5 * width, 0])
    with pytest.raises(DemonstrationError, match=advice):
        check_width(path)


@pytest.mark.parametrize("width", [0.0, 0.003, 0.3, 3.0])
def test_width_of_an_arms_path_or_of_a_point_is_accepted(width):
    check_width(demonstration(np.linspace(0, 1, 9)[:, None] * [0, width, 0]))


def test_positions_in_an_unknown_unit_are_refused():
    path = replace(demonstration(strokes()), units=("yd",) * 3)
    with pytest.raises(
        DemonstrationError, match="x, y and z are in yd, which is not a known"
    ):
        place_on_board(path, scenario=Scenario())


def test_a_transform_that_is_not_finite_is_refused_by_its_name():
    with pytest.raises(DemonstrationError, match="the transform"):
        place_on_board(
            demonstration(strokes()), scenario=Scenario(), transform=[np.nan] * 6
        )


def test_a_drawing_in_an_unknown_unit_is_refused():
    path = demonstration(strokes()).select(["x", "y"])
    with pytest.raises(DemonstrationError, match="are in px, which is not a known"):
        place_on_board(replace(path, units=("px", "px")), scenario=Scenario())


@pytest.mark.parametrize("transform", [None, [0.1, 0.2, 0.0, 0.0, 0.0, 0.3]])
@pytest.mark.parametrize("frame", ["", "board"])
def test_the_order_of_the_channels_does_not_matter(transform, frame):
    path = replace(demonstration(strokes()), frame=frame)
    expected, _ = place_on_board(path, scenario=Scenario(), transform=transform)
    placed, _ = place_on_board(
        path.select(["y", "z", "x"]), scenario=Scenario(), transform=transform
    )
    assert placed.channels == ("x", "y", "z")
    assert_allclose(placed.values, expected.values, atol=1e-12)


def test_real_demonstrations_fit_the_board(real_demonstration_paths):
    for name, path in real_demonstration_paths.items():
        recorded_demonstration = Demonstration.load(path)
        placement = fit_placement(recorded_demonstration, usable=USABLE)
        placed_path = placement.apply(recorded_demonstration).values
        assert np.all(placed_path[:, 2] >= 0), name
        placed_path = placed_path[samples_in_bouts(recorded_demonstration)]
        assert np.all(np.abs(placed_path[:, 0]) <= 0.2 + 1e-9), name
        assert np.all(np.abs(placed_path[:, 1]) <= 0.15 + 1e-9), name
        assert placement.touching > 0.1, name


@pytest.mark.parametrize(
    ("frame", "transform", "kept"),
    [("board", None, 4), ("base", None, 3), ("board", [0.0] * 6, 3)],
)
def test_force_is_played_where_the_recording_is_of_the_board_already(
    frame, transform, kept
):
    path = strokes()
    recording = Demonstration(
        time=np.arange(len(path)) / 50,
        values=np.column_stack([path, np.full(len(path), 8.0)]),
        channels=("x", "y", "z", "force"),
        units=("m", "m", "m", "N"),
        frame=frame,
    )
    placed, remarks = place_on_board(
        recording, scenario=Scenario(), transform=transform
    )
    assert len(placed.channels) == kept
    assert any("force left out" in remark for remark in remarks) == (kept == 3)


def test_tool_that_is_turned_is_played_where_the_recording_is_of_the_board():
    path, orientation = strokes(), Rotation.from_rotvec([0.1, 0.0, 0.2])
    recording = demonstration(path)
    posed_recording = add_orientation(
        recording, Rotation.concatenate([orientation] * 600)
    )
    for each, count in ((posed_recording, 6), (recording, 3)):
        placed, _ = place_on_board(replace(each, frame="board"), scenario=Scenario())
        assert len(placed.channels) == count


def test_recording_is_stretched_in_time(tmp_path):
    recording = demonstration(strokes())
    recording.save(tmp_path / "d.npz")
    (slow,), _ = load_as_recorded([tmp_path / "d.npz"], stretch=2.0)
    assert_allclose(slow.time, 2 * recording.time)
    assert_allclose(slow.values, recording.values)


@pytest.mark.parametrize("is_accepted", [True, False])
def test_path_may_be_scaled_down_to_three_tenths(is_accepted):
    scenario = Scenario()
    usable = np.array(scenario.board.size) - scenario.eraser.footprint - 0.02
    path = strokes(noise=0.0, lift=0.0)
    path *= usable[0] / np.ptp(path[:, 0]) / (0.301 if is_accepted else 0.299)
    if is_accepted:
        _, remarks = place_on_board(demonstration(path), scenario=scenario)
        assert "at 30 % of its size" in remarks[0]
        return
    with pytest.raises(DemonstrationError, match="at 30 % of its size; at least 30 %"):
        place_on_board(demonstration(path), scenario=scenario)


def test_recording_without_a_position_is_kept_where_no_board_is_needed():
    values = np.random.default_rng(0).normal(size=(50, 2))
    recording = Demonstration(
        time=np.arange(50) / 50, values=values, channels=("a", "b"), units=("1", "1")
    )
    kept, remarks = place_on_board(recording, scenario=Scenario(), needs_board=False)
    assert kept is recording
    assert remarks == ["as recorded: without x, y and z there is no board"]
    with pytest.raises(DemonstrationError, match="the board needs x, y and z"):
        place_on_board(recording, scenario=Scenario())


@pytest.mark.parametrize("names", [("rx", "ry", "rz"), ("j1", "j2", "j3")])
def test_an_orientation_is_not_taken_for_joints_of_another_robot(names):
    recorded = Demonstration(
        time=np.arange(100) / 50,
        values=np.random.default_rng(0).random((100, 3)),
        channels=names,
        units=("rad",) * 3,
    )
    with pytest.raises(DemonstrationError) as refusal:
        place_on_board(recorded, scenario=Scenario())
    assert ("Joints of another robot" in str(refusal.value)) == (names[0] == "j1")


@pytest.mark.parametrize(
    ("make", "columns"),
    [
        (files.two_hands, "x=left_x,y=left_y,z=left_z"),
        (files.left_and_right, "x=l_x,y=l_y,z=l_z"),
        (files.two_arms, ",".join(f"joint{i}=left_arm_q{i}" for i in range(1, 8))),
    ],
)
@pytest.mark.parametrize("needs_board", [True, False])
def test_recording_of_two_arms_is_refused_with_the_columns_of_one(
    make, columns, needs_board, tmp_path
):
    path = make(tmp_path).path
    with pytest.raises(DemonstrationError, match=f"several .* --columns {columns}, or"):
        load_on_board(
            [path],
            scenario=Scenario(),
            transform=None,
            stretch=1.0,
            needs_board=needs_board,
        )
    reading = ReadingOptions(columns=dict(c.split("=") for c in columns.split(",")))
    (chosen,), _ = load_as_recorded([path], stretch=1.0, reading=reading)
    assert set(chosen.channels) <= {"x", "y", "z"} or RobotJoints(chosen)


def test_columns_are_suggested_by_their_axes():
    recording = Demonstration(
        time=np.arange(4.0),
        values=np.zeros((4, 6)),
        channels=[f"{axis}_{hand}" for axis in "xyz" for hand in ("one", "two")],
    )
    with pytest.raises(DemonstrationError, match="--columns x=x_one,y=y_one,z=z_one"):
        place_on_board(recording, scenario=Scenario())


@pytest.mark.parametrize("form", ["velocity_{}", "{}_dot"])
def test_names_of_velocities_and_angles_are_not_suggested_as_a_position(form):
    names = (*map(form.format, "xyz"), "tx_base", "ty_base", "tz_base")
    recorded = Demonstration(
        time=np.arange(100) / 50,
        values=np.random.default_rng(0).random((100, 6)),
        channels=names,
        units=("1",) * 6,
    )
    with pytest.raises(
        DemonstrationError, match=r"--columns x=tx_base,y=ty_base,z=tz_base$"
    ):
        place_on_board(recorded, scenario=Scenario())
    torques = replace(recorded.select(names[3:]), units=("Nm",) * 3)
    for others in (recorded.select(names[:3]), torques):
        with pytest.raises(DemonstrationError, match=r"x=COLUMN,y=COLUMN,z=COLUMN$"):
            place_on_board(others, scenario=Scenario())


def test_a_drawing_is_placed_on_the_board():
    path = strokes(lift=0.0, noise=0.0)
    drawing = Demonstration(
        time=np.arange(600) / 50,
        values=np.column_stack([path[:, :2], np.ones(600)]),
        channels=("x", "y", "pressure"),
        units=("m", "m", "1"),
    )
    placed, remarks = place_on_board(drawing, scenario=Scenario())
    assert placed.channels == ("x", "y", "z")
    assert placed.units == ("m", "m", "m")
    low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    assert_allclose(placed.values[:, :2], path[:, :2] - (low + high) / 2, atol=1e-9)
    assert np.all(placed.values[:, 2] == 0.0)
    assert remarks[0] == "x and y without z: taken as a drawing on the board"


def loaded_thirds(folder, *, shift=(0.0, 0.0, 0.0), frame="base"):
    """Return three recordings of one movement, the last one shifted, placed, and remarks."""
    parts = np.split(strokes(count=1800, lift=0.3), 3)
    recordings = [demonstration(part) for part in parts[:2]]
    recordings.append(replace(demonstration(parts[2] + shift), frame=frame))
    paths = [folder / f"{number}.npz" for number in range(3)]
    for recording, file in zip(recordings, paths, strict=True):
        recording.save(file)
    return recordings, *load_on_board(paths, scenario=Scenario())


def test_recordings_of_one_movement_in_one_frame_are_placed_together(tmp_path):
    recordings, placed, remarks = loaded_thirds(tmp_path, shift=(0.01, 0.0, 0.0))
    union, placed_union = (
        np.concatenate([each.values[:, :2] for each in part])
        for part in (recordings, placed)
    )
    shift = placed_union - union
    assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=0.002)
    middle = (placed_union.min(axis=0) + placed_union.max(axis=0)) / 2
    assert_allclose(middle, 0, atol=1e-9)
    assert sum("by the common plane of all recordings" in r for r in remarks) == 3


@pytest.mark.parametrize(
    "options",
    [
        {"shift": (0.1, 0.0, 0.0)},
        {"shift": (0.0, 0.0, 0.04)},
        {"shift": (0.0, 0.0, -0.04)},
        {"frame": "camera"},
    ],
)
def test_recordings_between_which_the_board_was_moved_are_placed_alone(
    options, tmp_path
):
    recordings, placed, remarks = loaded_thirds(tmp_path, **options)
    for recording, each in zip(recordings, placed, strict=True):
        alone, _ = place_on_board(recording, scenario=Scenario())
        assert np.array_equal(each.values, alone.values)
    assert not any("common" in remark for remark in remarks)


def test_a_recording_of_the_board_is_unchanged_beside_others(tmp_path):
    recordings, placed, remarks = loaded_thirds(tmp_path, frame="board")
    assert np.array_equal(placed[2].values, recordings[2].values)
    assert sum("the common plane" in remark for remark in remarks) == 2


def test_recorded_joints_are_placed_together(tmp_path):
    posture = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])
    time = np.arange(400) / 20
    swing = [0.3, 0.1, 0, 0.1, 0, 0, 0] * np.sin(time[:, None] + [0, 1, 0, 1, 0, 0, 0])
    joints = Demonstration(
        time=time,
        values=posture + swing * np.linspace(1.0, 1.05, 400)[:, None],
        channels=tuple(f"panda_joint{i}" for i in range(1, 8)),
        units=("rad",) * 7,
    )
    paths = [tmp_path / "one.npz", tmp_path / "two.npz"]
    for file, rows in zip(paths, (slice(200), slice(200, 400)), strict=True):
        joints.rows(np.arange(400)[rows]).save(file)
    _, remarks = load_on_board(paths, scenario=Scenario())
    assert sum("the common plane" in remark for remark in remarks) == 2


def test_two_real_recordings_of_one_cycle_each_are_joined(
    real_demonstration_paths, tmp_path
):
    whole = Demonstration.load(real_demonstration_paths["drums_03"])
    paths = [tmp_path / "one.npz", tmp_path / "two.npz"]
    for file, rows in zip(paths, np.split(np.arange(1000), 2), strict=True):
        whole.rows(rows).save(file)
    recordings, _ = load_on_board(paths, scenario=Scenario())
    rhythm = find_rhythm(recordings)
    assert rhythm.cycles == pytest.approx(2, abs=0.1)
    assert rhythm.period == pytest.approx(5, abs=0.1)
