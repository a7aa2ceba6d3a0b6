"""Facts about a robot at a board without a skill, and with one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import StationError
from fmp_drake.station import LcmPanda, LoadScenario, MakeStation
from fmp_drake.station.robots.driver import SimulatedDriver

COMMON = {
    "measured_position": 3,
    "measured_velocity": 3,
    "measured_pose": 7,
    "tracking_error": 6,
    "normal_force": 1,
    "status": 6,
    "last_fault": 1,
    "torque": 7,
    "state": 14,
    "torque_measured": 7,
    "torque_external": 7,
    "mode": 1,
    "age": 1,
}
DESIRED = ("desired_position", "desired_velocity", "desired_acceleration")


def ports(station):
    return {
        station.get_output_port(i).get_name(): station.get_output_port(i).size()
        for i in range(station.num_output_ports())
    }


def test_both_arms_have_the_same_ports_and_lcm_has_its_own_besides(restless_skill):
    scenario = LoadScenario("table_top")
    arms = {
        SimulatedDriver: (),
        LcmPanda: ("torque_sent", "faults"),
    }
    for arm, own in arms.items():
        config = arm()
        board = MakeStation(scenario, None, driver=config, lcm=DrakeLcm("memq://"))
        station_ports = ports(board)
        assert {k: v for k, v in station_ports.items() if k not in own} == COMMON
        assert set(own) <= set(station_ports)
        for name in (*DESIRED, "desired_normal_force"):
            board.GetInputPort(name)
        for name in ("wall_time", "go"):
            assert board.HasInputPort(name) == (arm is LcmPanda)
        skilled = MakeStation(
            scenario, restless_skill, driver=config, lcm=DrakeLcm("memq://")
        )
        controlled = {
            "measured_position",
            "tracking_error",
            "status",
            "torque",
            "state",
        }
        assert set(DESIRED) | controlled | {"normal_force"} <= ports(skilled).keys()
        if arm is LcmPanda:
            of_skill = {*DESIRED, "covariance", "weights", "component", "remaps"}
            assert ports(skilled).keys() == station_ports.keys() | of_skill
            assert skilled.HasInputPort("tempo")


def test_simulated_robot_follows_its_inputs():
    scenario = LoadScenario("table_top")
    board = MakeStation(scenario, None, driver=SimulatedDriver())
    simulator = Simulator(board)
    context = simulator.get_mutable_context()
    goal = np.add(scenario.start, [0.0, 0.03, 0.0])
    for name, value in zip(DESIRED, (goal, np.zeros(3), np.zeros(3)), strict=True):
        board.GetInputPort(name).FixValue(context, value)
    simulator.AdvanceTo(1.0)
    position = board.GetOutputPort("measured_position").Eval(context)
    assert_allclose(position, goal, atol=2e-3)
    free = board.GetOutputPort("torque_external").Eval(context)
    assert_allclose(free, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "source"),
    [("table_top", "controller"), ("wipe_dome", "measured_coordinates")],
)
def test_ink_of_a_real_arm_follows_the_position_on_the_surface(
    name, source, restless_skill
):
    scenario, lcm = LoadScenario(name), DrakeLcm("memq://")
    station = MakeStation(scenario, restless_skill, driver=LcmPanda(), lcm=lcm)
    ink = station.GetSubsystemByName("wiped_area")
    port = ink.GetInputPort("measured_position").get_index()
    (sender,) = [
        output[0] for i, output in station.connection_map().items() if i == (ink, port)
    ]
    assert sender.get_name() == source


def test_a_board_that_moves_is_refused_where_nothing_measures_it():
    with pytest.raises(StationError, match=r"motion.amplitude is 0.* Set it to 0"):
        MakeStation(
            LoadScenario("moving_board"),
            None,
            driver=LcmPanda(),
            lcm=DrakeLcm("memq://"),
        )


def test_initial_angles_out_of_range_are_refused_by_the_name_of_the_joint():
    with pytest.raises(StationError, match=r"^q is not .* has 9 for panda_joint1, who"):
        MakeStation(LoadScenario("table_top"), None, q=np.full(7, 9.0))


def test_an_arm_that_was_pushed_against_a_limit_starts_at_it():
    """A plant permits a joint to be up to a microradian beyond its limit."""
    limit = 2.8973
    q = np.array([limit + 1e-6, -0.6, 0.0, -2.2, 0.0, 1.6, 0.8])
    station = MakeStation(LoadScenario("table_top"), None, q=q)
    state = station.GetOutputPort("state").Eval(station.CreateDefaultContext())
    assert_allclose(state[:7], q, atol=2e-6)
    assert state[0] <= limit
