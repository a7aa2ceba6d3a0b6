"""Facts about skills with rotation and force channels in a station."""

import copy

import numpy as np
import pytest
from posed_recordings import demonstration
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from fmp_drake.errors import StationError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    transform_space,
)
from fmp_drake.station import MakeStation, Scenario
from fmp_drake.station.page import BOARD
from fmp_drake.station.skill_motion import ContactHeight

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def stirring():
    return FourierMovementPrimitive(n_components=30).fit(
        demonstration(height=0.15, tilt=0.4)
    )


@pytest.fixture(scope="module")
def pulsing():
    shown = demonstration(height=-0.002, force=(10.0, 4.0))
    return FourierMovementPrimitive(n_components=30).fit(shown)


def scenario(**press):
    made = Scenario()
    made.impedance.rotational_stiffness = [60.0, 60.0, 60.0]
    for name, value in press.items():
        setattr(made.press, name, value)
    return made


def samples(station, names, *, seconds, after):
    """Return what output ports say every 50 ms after some seconds, each (N, size)."""
    simulator = Simulator(station)
    context = simulator.get_context()
    rows = {name: [] for name in names}
    for k in range(1, round(seconds / 0.05) + 1):
        simulator.AdvanceTo(0.05 * k)
        if 0.05 * k > after:
            for name, values in rows.items():
                values.append(np.array(station.GetOutputPort(name).Eval(context)))
    return [np.array(rows[name]) for name in names]


def rms(values):
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


def test_six_channels_are_followed_in_position_and_orientation(stirring):
    station = MakeStation(scenario(force=0.0), stirring, start=[0.06, 0.0, 0.15])
    error, pose = samples(
        station, ("tracking_error", "measured_pose"), seconds=4.5, after=1.0
    )
    assert rms(error[:, 3:]) < 1e-3
    assert np.rad2deg(rms(error[:, :3])) < 0.5
    # The tool does lean: by up to 0.4 rad to every side.
    axis = Rotation.from_quat(pose[:, :4], scalar_first=True).apply([0.0, 0.0, 1.0])
    assert np.all(np.ptp(axis[:, :2], axis=0) > 0.6)


def test_free_space_has_neither_board_nor_ink_nor_force(stirring):
    free = scenario()
    free.board.shape = "none"
    meshcat = Meshcat()
    station = MakeStation(free, stirring, start=[0.06, 0.0, 0.15], meshcat=meshcat)
    assert not station.HasOutputPort("ink")
    plant = station.GetSubsystemByName("plant")
    assert not plant.HasModelInstanceNamed("whiteboard")
    assert "press force (N)" not in meshcat.GetSliderNames()
    error, force = samples(
        station, ("tracking_error", "normal_force"), seconds=3.5, after=1.5
    )
    assert rms(error[:, 3:]) < 1e-3
    assert np.rad2deg(rms(error[:, :3])) < 0.5
    assert np.max(np.abs(force)) < 1e-6


def test_nothing_moves_where_there_is_no_board():
    free = scenario()
    free.board.shape = "none"
    free.board.motion.amplitude = 0.1
    with pytest.raises(StationError, match=r"set board\.motion\.amplitude to 0"):
        MakeStation(free, None)


def test_a_force_channel_is_pressed(pulsing):
    wiping = scenario()
    wiping.impedance.force_control.enabled = True
    station = MakeStation(wiping, pulsing)
    force, motion = samples(
        station, ("normal_force", "desired_normal_force"), seconds=5.5, after=2.0
    )
    assert np.ptp(motion) > 6.0
    assert rms(force - motion) < 0.5


def lifted(skill):
    """Return a skill whose recording is 40 mm above the board for half of the time."""
    skill = copy.deepcopy(skill)
    for path in skill.paths_:
        path[::2, 2] += 0.04
    return skill


def test_a_recording_that_is_never_lifted_is_in_contact_up_to_its_greatest_height():
    shown = demonstration(height=0.004)
    low = FourierMovementPrimitive(n_components=2).fit(shown)
    assert ContactHeight(scenario(), low) == pytest.approx(0.004)
    assert ContactHeight(scenario(engage_height=0.003), low) == 0.0
    assert ContactHeight(scenario(), lifted(low)) == 0.0
    below = transform_space(low, translation=[0.0, 0.0, -0.005])
    assert ContactHeight(scenario(), below) == 0.0


def test_a_force_channel_tells_where_a_lifted_tool_presses(pulsing):
    assert ContactHeight(scenario(), pulsing) == 0.0
    assert ContactHeight(scenario(engage_height=0.02), lifted(pulsing)) == 0.02


def test_a_recording_that_rises_a_little_is_pressed_with_the_whole_force():
    skill = FourierMovementPrimitive(n_components=10).fit(demonstration(height=0.004))
    (force,) = samples(
        MakeStation(scenario(), skill), ("normal_force",), seconds=4.5, after=2.5
    )
    assert np.max(np.abs(force - 10.0)) < 1.0


def test_no_more_force_is_pressed_than_was_demonstrated(pulsing):
    skill = copy.deepcopy(pulsing)
    skill.extent_[1, -1] = 10.0  # Less than its samples have.
    station = MakeStation(scenario(), skill)
    (desired,) = samples(station, ("desired_normal_force",), seconds=2.5, after=1.0)
    assert np.max(desired) == 10.0
    assert np.min(desired) < 9.0


def test_a_page_shows_the_plan_of_six_channels_and_changes_nothing(stirring):
    def last_state(meshcat):
        station = MakeStation(
            scenario(force=0.0), stirring, start=[0.06, 0.0, 0.15], meshcat=meshcat
        )
        simulator = Simulator(station)
        simulator.AdvanceTo(1.0)
        return station.GetOutputPort("state").Eval(simulator.get_context())

    meshcat = Meshcat()
    np.testing.assert_array_equal(last_state(meshcat), last_state(None))
    assert meshcat.HasPath(f"{BOARD}/plan/line")
    assert meshcat.HasPath(f"{BOARD}/plan/tube")


def test_a_channel_without_a_role_is_refused():
    t = np.arange(0, 20, 0.05)
    shown = Demonstration(
        time=t,
        values=np.column_stack([np.sin(2 * t), np.cos(2 * t), 0 * t, np.sin(4 * t)]),
        channels=("x", "y", "z", "grip"),
        units=("m", "m", "m", "1"),
    )
    skill = FourierMovementPrimitive(n_steps=20, n_components=2).fit(shown)
    with pytest.raises(StationError, match="channel grip has no role"):
        MakeStation(Scenario(), skill)
