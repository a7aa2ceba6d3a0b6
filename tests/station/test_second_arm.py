"""Facts about a station of another arm: a URDF of six joints and its YAML file.

The YAML file is the one of the page "Your own robot in ten lines of YAML".
"""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmp_drake.errors import StationError
from fmp_drake.runs import RunLog, WipingRun
from fmp_drake.skills import scenario_skill
from fmp_drake.station import CheckFeasibility, LoadRobot, LoadScenario, MakeStation
from fmp_drake.station.robots.robot import MakeRobotModel
from fmp_drake.systems.impedance.controller_status import StatusFlag

# Axis, origin in the link before (z, m), length of the capsule (m), mass (kg), effort (Nm).
JOINTS = (
    ("0 0 1", 0.00, 0.16, 4.0, 150.0),
    ("0 1 0", 0.16, 0.45, 7.0, 150.0),
    ("0 1 0", 0.45, 0.25, 3.0, 150.0),
    ("0 0 1", 0.25, 0.15, 2.0, 28.0),
    ("0 1 0", 0.15, 0.05, 1.0, 28.0),
    ("0 0 1", 0.05, 0.03, 0.5, 28.0),
)
PAGE = (
    Path(__file__).resolve().parents[2] / "examples" / "site" / "howto" / "robots.rst"
)
_BLOCK = r"^\.\. code-block:: yaml\n\n((?:   .*\n)+)"
ROBOT = re.sub(
    "^   ",
    "",
    re.search(_BLOCK, PAGE.read_text("utf-8"), re.MULTILINE)[1],
    flags=re.MULTILINE,
)
POSTURE = [0.0, 0.506, 1.657, 0.0, 0.979, 0.0]


def urdf():
    text = '<robot name="six"><link name="base"/>'
    before = "base"
    for i, (axis, origin, length, mass, effort) in enumerate(JOINTS, start=1):
        moment = mass * (length**2 / 12 + 0.002)
        text += f"""
<link name="link{i}">
  <inertial><origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>
    <inertia ixx="{moment}" iyy="{moment}" izz="{0.004 * mass}" ixy="0" ixz="0" iyz="0"/>
  </inertial>
  <collision><origin xyz="0 0 {length / 2}"/>
    <geometry><drake:capsule radius="0.04" length="{length}"/></geometry>
  </collision>
</link>
<joint name="joint{i}" type="revolute">
  <parent link="{before}"/><child link="link{i}"/>
  <origin xyz="0 0 {origin}"/><axis xyz="{axis}"/>
  <limit lower="-3.1" upper="3.1" velocity="3.14" effort="{effort}"/>
</joint>
<transmission name="transmission{i}"><type>SimpleTransmission</type>
  <joint name="joint{i}"/><actuator name="motor{i}"/>
</transmission>"""
        before = f"link{i}"
    return f"""{text}
<link name="flange"/>
<joint name="flange_joint" type="fixed">
  <parent link="link6"/><child link="flange"/><origin xyz="0 0 0.03"/>
</joint>
</robot>""".replace("<robot ", '<robot xmlns:drake="http://drake.mit.edu" ')


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("six")
    (folder / "arm.urdf").write_text(urdf())
    (folder / "six.yaml").write_text(ROBOT)
    (folder / "scenario.yaml").write_text("robot: six.yaml\n")
    return folder


@pytest.fixture(scope="module")
def run(folder, bundled_skill):
    scenario = LoadScenario(folder / "scenario.yaml")
    signals = ("normal_force", "status", "state", "torque")
    run = WipingRun(scenario, bundled_skill, keep=signals)
    run.advance_to(4.0)
    return run


def test_ten_lines_describe_a_robot():
    assert len(ROBOT.splitlines()) == 10


def test_a_scenario_names_a_robot_beside_it(folder):
    scenario = LoadScenario(folder / "scenario.yaml")
    robot = LoadRobot(scenario.robot)
    assert robot.model == str(folder / "arm.urdf")
    assert scenario.preferred_posture() == POSTURE
    assert robot.complete(scenario.impedance).max_torque_rate == 1500.0


def test_six_joints_wipe_the_board_with_the_bundled_skill(run):
    time, force = run.log_times("normal_force"), run.log("normal_force")[:, 0]
    contact_force = force[time > 2.0]
    assert_allclose(np.mean(contact_force), 10.0, atol=1.0)
    assert np.min(contact_force) > 4.0
    flags = np.bitwise_or.reduce(run.log("status")[:, 0].astype(int))
    assert not flags & (StatusFlag.PROTECTIVE_STOP | StatusFlag.ARM_TOUCHES)
    metrics = run.metrics()
    assert metrics["tracking_rms_m"] < 0.01
    assert metrics["cleaned_fraction"] > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["polish_pipe", "wipe_dome"])
def test_six_joints_wipe_a_curved_surface(folder, name):
    scenario = LoadScenario(name, robot=str(folder / "six.yaml"))
    skill, _, _ = scenario_skill(scenario)
    assert CheckFeasibility(scenario, skill).is_feasible
    run = WipingRun(scenario, skill)
    run.advance_to(6.0)
    metrics = run.metrics()
    assert 9.0 < metrics["normal_force_p05_n"] < metrics["normal_force_p95_n"] < 11.0
    assert metrics["tracking_rms_m"] < 0.005
    assert metrics["protective_stop_s"] == metrics["arm_on_board_s"] == 0
    assert metrics["cleaned_fraction_of_demonstrated_area"] > 0.6


def test_its_log_has_the_columns_of_six_joints(run, tmp_path):
    run.save_log(tmp_path / "run.npz", {})
    log = RunLog.load(tmp_path / "run.npz")
    assert log["torque"].columns == tuple(f"joint{i}" for i in range(1, 7))
    assert log["state"].values.shape[1] == 12
    assert log["state"].columns[6] == "joint1_velocity"
    assert log["state"].unit == ",".join(["rad"] * 6 + ["rad/s"] * 6)


@pytest.mark.usefixtures("no_remedy")
def test_its_reach_is_checked(folder, bundled_skill):
    scenario = LoadScenario("vertical", robot=str(folder / "six.yaml"))
    assert scenario.preferred_posture() == POSTURE
    scenario = LoadScenario("table_top", robot=str(folder / "six.yaml"))
    feasibility = CheckFeasibility(scenario, bundled_skill)
    assert feasibility.posture.shape == (6,)
    assert feasibility.values["reachable_fraction"] > 0.99
    scenario.board.translation = [1.1, 0.0, 0.1]
    assert not CheckFeasibility(scenario, bundled_skill, suggest=False).is_feasible


def test_an_arm_that_touches_itself_is_refused_with_the_bodies(folder, bundled_skill):
    text, count = re.subn(r"contact_free.*\n.*\n", "", ROBOT)
    assert count == 1
    (folder / "touching.yaml").write_text(text)
    scenario = LoadScenario("table_top", robot=str(folder / "touching.yaml"))
    found = CheckFeasibility(scenario, bundled_skill, suggest=False)
    assert not found.is_feasible
    touching = r"on 100\.0 % of the path (link\d|eraser) and link\d touch each other; .* contact_free"
    assert re.search(touching, found.verdict)


def test_what_it_says_about_an_arm_that_touches_itself_can_be_followed(
    folder, bundled_skill
):
    text, pairs = re.sub(r"contact_free.*\n.*\n", "", ROBOT), []
    for _ in range(3):
        free = f"contact_free: {pairs}\n".replace("'", "")
        (folder / "followed.yaml").write_text(text + free)
        scenario = LoadScenario("table_top", robot=str(folder / "followed.yaml"))
        found = CheckFeasibility(scenario, bundled_skill)
        if found.is_feasible:
            break
        # A move of the board is not tried, as it cannot help.
        assert found.verdict.endswith(" help: another posture, or contact_free.")
        pair = re.search(r"path (\w+) and (\w+) touch", found.verdict)
        pairs.append(list(pair.groups()))
    assert sorted(pairs) == [["link4", "link6"], ["link5", "tool"]]


def test_a_rate_of_torque_with_which_the_arm_oscillates_is_refused(
    folder, bundled_skill
):
    scenario = LoadScenario("table_top", robot=str(folder / "six.yaml"))
    scenario.impedance.max_torque_rate = 80.0
    verdict = CheckFeasibility(scenario, bundled_skill).verdict
    match = re.search(
        r"oscillate with a max_torque_rate of 80 Nm/s\. What would help: a max_torque_rate "
        r"of (\d+) Nm/s",
        verdict,
    )
    scenario.impedance.max_torque_rate = float(match[1])
    assert CheckFeasibility(scenario, bundled_skill).is_feasible


def test_the_page_gives_the_inertia_of_the_motors_without_which_it_is_refused(
    folder, bundled_skill
):
    (folder / "light.yaml").write_text(re.sub("reflected_inertia.*\n", "", ROBOT))
    scenario = LoadScenario("table_top", robot=str(folder / "light.yaml"))
    for attempt in (CheckFeasibility, MakeStation):
        with pytest.raises(
            StationError,
            match=r"joint6 of arm\.urdf has .* 0\.0021 kg m².* reflected_inertia: \[0\.1\]",
        ):
            attempt(scenario, bundled_skill)


def test_a_posture_of_another_length_is_refused(folder):
    (folder / "bent.yaml").write_text(
        "robot: six.yaml\nposture: [0, 0, 0, 0, 0, 0, 0]\n"
    )
    with pytest.raises(StationError, match=r"posture is .* expected 6 numbers"):
        LoadScenario(folder / "bent.yaml")
    (folder / "named.yaml").write_text(ROBOT + "joint_names: [lift, elbow]\n")
    with pytest.raises(StationError, match=r"joint_names is .* expected 6 names"):
        LoadRobot(folder / "named.yaml")
    text = ROBOT.replace(f"posture: {POSTURE}", "posture: [0.0, 0.5]")
    (folder / "short.yaml").write_text(text)
    with pytest.raises(StationError, match=r"give an angle for each of the 6 joints"):
        MakeRobotModel(LoadRobot(folder / "short.yaml"))
