"""Facts about the stability of a sampled controller, and of one with delayed sensors."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station import LoadRobot, Scenario, models_dir
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.robots.robot import MakeRobotModel
from fmp_drake.station.robots.stability import (
    CheckStability,
    stability_limit,
    stability_ratio,
)
from fmp_drake.station.scenario_parts import SensorConfig
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.joints import (
    JointLimits,
    JointWallConfig,
    wall_torque,
)
from fmp_drake.systems.impedance.records import values_of

PERIOD = 0.001
WALLS = JointWallConfig()


def is_stable(torque, inertia):
    """Simulate a joint, with a torque (q, v) a period late, from 0.1 mrad beside its rest."""
    q, v, applied, path = 1e-4, 0.0, 0.0, []
    for _ in range(6000):
        computed = torque(q, v)
        v += PERIOD * applied / inertia
        q += PERIOD * v
        applied = computed
        path.append(abs(q))
        if path[-1] > 1.0:
            return False
    return max(path[-1000:]) < 1e-4


def edge(stable, low, high):
    """Return the number between an unstable and a stable one at which stability begins."""
    for _ in range(12):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if stable(middle) else (middle, high)
    return np.sqrt(low * high)


@pytest.mark.parametrize("damping_ratio", [0.3, 0.7, 1.0, 2.0])
def test_the_least_inertia_in_a_spring_is_that_of_a_simulated_loop(damping_ratio):
    stiffness = 60.0

    def stable(inertia):
        damping = 2 * damping_ratio * np.sqrt(stiffness * inertia)
        return is_stable(lambda q, v: -stiffness * q - damping * v, inertia)

    def bound(inertia):
        frequency = np.sqrt(stiffness / inertia)
        damping = 2 * damping_ratio * frequency
        return stability_ratio(stiffness / inertia, damping, PERIOD) < 1

    least = edge(stable, 1e-6, 1e-1)
    assert_allclose(edge(bound, 1e-6, 1e-1), least, rtol=0.05)
    largest = 2 * damping_ratio / (1 + 4 * damping_ratio**2)
    assert_allclose(stiffness * PERIOD**2 / largest**2, least, rtol=0.05)


def decays_with(delay, damping_ratio, frequency=25.0):
    """Return whether a spring with a delay (s) comes to rest."""
    step, x, v, peaks = 1e-4, 1.0, 0.0, []
    history = [(x, v)] * (round(delay / step) + 1)
    for _ in range(40_000):
        old_x, old_v = history.pop(0)
        v -= step * (2 * damping_ratio * frequency * old_v + frequency**2 * old_x)
        x += step * v
        history.append((x, v))
        peaks.append(abs(x))
    return max(peaks[-10_000:]) < 0.5 * max(peaks[5_000:15_000])


@pytest.mark.parametrize("damping_ratio", [0.3, 0.7, 1.0, 2.0])
def test_the_longest_delay_of_a_spring_is_that_of_a_simulated_loop(damping_ratio):
    limit = stability_limit(25.0**2, damping_ratio)
    assert decays_with(0.9 * limit, damping_ratio)
    assert not decays_with(1.1 * limit, damping_ratio)


@pytest.mark.parametrize(
    ("robot", "longest"), [("panda", 0.015), ("iiwa14", 0.01), ("ur5e", 0.011)]
)
def test_a_delay_that_makes_the_arm_oscillate_is_refused(robot, longest):
    sensors = SensorConfig(rate=1000.0, delay=longest - 0.0015)
    scenario = Scenario(robot=robot, sensors=sensors)
    AddBoardScene(DiagramBuilder(), scenario, start=[0, 0, 0.05])
    sensors.delay = 0.025
    with pytest.raises(StationError, match=f"at most {longest:g} s with this arm"):
        AddBoardScene(DiagramBuilder(), scenario, start=[0, 0, 0.05])


def wall_of(effort):
    """Return a function of q, v, inertia: a torque pushes into a limit spring, to q = 0."""
    limits = JointLimits.between(
        np.array([-1.0]),
        np.array([1.0]),
        speed=np.array([3.0]),
        lower_effort=np.array([-effort]),
        upper_effort=np.array([effort]),
    )

    def total(q, v, inertia):
        def wall(q, v):
            values = np.array([q]), np.array([v]), np.array([inertia])
            return wall_torque(values_of(WALLS), limits, *values).torque[0]

        deep = 1.0 - 0.2 * WALLS.width
        return wall(deep + q, v) - wall(deep, 0.0)

    return total


def test_the_least_inertia_at_a_joint_limit_is_that_of_a_simulated_loop():
    wall, effort = wall_of(28.0), 28.0

    def bound(inertia):
        stiffness = 2 * effort / WALLS.width / inertia
        return stability_ratio(stiffness, 1 / WALLS.braking_time, PERIOD) < 1

    least = edge(lambda m: is_stable(lambda q, v: wall(q, v, m), m), 1e-4, 1e-1)
    assert_allclose(edge(bound, 1e-4, 1e-1), least, rtol=0.05)
    assert_allclose(least, 0.0062, rtol=0.05)


@pytest.mark.parametrize("inertia", [0.001, 0.1])
def test_the_limit_of_a_joint_without_an_effort_limit_is_stable(inertia):
    wall = wall_of(np.inf)
    assert is_stable(lambda q, v: wall(q, v, inertia), inertia)


def own(folder, line):
    """Write the UR5e's file with another line, and return its model."""
    file = models_dir() / "ur5e" / "ur5e.yaml"
    text = file.read_text().replace("ur5e.urdf", str(file.with_suffix(".urdf")))
    (folder / "own.yaml").write_text(f"{text}\n{line}\n")
    return MakeRobotModel(LoadRobot(folder / "own.yaml"))


def inertias(robot):
    plant = robot.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, robot.config.posture)
    return np.diag(plant.CalcMassMatrix(context))


@pytest.mark.parametrize(
    ("line", "added"),
    [
        ("reflected_inertia: [0.25]", 0.15),
        ("reflected_inertia: [1]", 0.9),
        ("reflected_inertia: [5e-2] # of each motor", -0.05),
        (
            "reflected_inertia: [0.3, 0.3, 0.3, 0.2, 0.2, 0.1]",
            [0.2] * 3 + [0.1] * 2 + [0],
        ),
        ("", 0.0),
    ],
)
def test_the_inertia_of_the_motors_replaces_the_models(tmp_path, line, added):
    robot = own(tmp_path, line)
    own_inertias = inertias(MakeRobotModel(LoadRobot("ur5e")))
    assert_allclose(inertias(robot), own_inertias + added, atol=1e-12)


def test_the_simulated_arm_has_the_inertia_of_its_motors(tmp_path):
    robot = own(tmp_path, "reflected_inertia: [0.25]")
    scenario = Scenario(robot=str(tmp_path / "own.yaml"))
    plant = AddBoardScene(DiagramBuilder(), scenario, start=[0, 0, 0.05]).plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, robot.config.posture)
    assert_allclose(np.diag(plant.CalcMassMatrix(context)), inertias(robot), rtol=1e-9)


@pytest.mark.parametrize(
    "line", ["reflected_inertia: [-0.1]", "reflected_inertia: [1, 2]"]
)
def test_inertias_that_are_negative_or_too_few_are_refused(tmp_path, line):
    with pytest.raises(StationError, match="reflected_inertia"):
        own(tmp_path, line)


def test_a_joint_just_below_its_least_inertia_is_refused(tmp_path):
    with pytest.raises(StationError, match=r"ur5e_joint6 .* at least") as refusal:
        CheckStability(own(tmp_path, "reflected_inertia: [0]"), ImpedanceConfig())
    needed = float(re.search(r"at least ([\d.]+) kg", str(refusal.value))[1])
    enough = own(tmp_path, f"reflected_inertia: [{1.1 * needed}]")
    CheckStability(enough, ImpedanceConfig())
    with pytest.raises(StationError, match="ur5e_joint6"):
        CheckStability(enough, ImpedanceConfig(control_period=0.0012))
    few = own(tmp_path, f"reflected_inertia: [{0.8 * needed}]")
    with pytest.raises(StationError, match="ur5e_joint6"):
        CheckStability(few, ImpedanceConfig())


def test_an_effort_limit_that_no_inertia_makes_stable_is_named(tmp_path):
    file = models_dir() / "ur5e" / "ur5e.urdf"
    text = re.sub(r'effort="[^"]*"', 'effort="1e9"', file.read_text())
    (tmp_path / "strong.urdf").write_text(text)
    text = file.with_suffix(".yaml").read_text().replace("ur5e.urdf", "strong.urdf")
    (tmp_path / "strong.yaml").write_text(text)
    robot = MakeRobotModel(LoadRobot(tmp_path / "strong.yaml"))
    with pytest.raises(StationError, match=r"correct .*6's effort limit of 1e\+09 Nm"):
        CheckStability(robot, ImpedanceConfig())


def test_springs_of_the_tool_need_inertia_too(tmp_path):
    robot = own(tmp_path, "reflected_inertia: [0.01]")
    CheckStability(robot, ImpedanceConfig())
    with pytest.raises(StationError, match="reflected_inertia"):
        CheckStability(robot, ImpedanceConfig(damping_ratio=0.02))


def test_a_control_period_that_no_inertia_makes_stable_is_refused():
    robot = MakeRobotModel(LoadRobot("panda"))
    with pytest.raises(StationError, match=r"control_period is 0\.01 s"):
        CheckStability(robot, ImpedanceConfig(control_period=0.01))
