"""Facts about `fmp-drake robots`, and about the option --robot of other commands."""

import json
import re

import pytest

from fmp_drake.station import LoadRobot, models_dir
from fmp_drake.station.robots.robot import ListRobots


def test_every_robot_is_listed_with_its_joints_and_reach(command):
    result = command("robots")
    assert result.code == 0
    assert result.err == ""
    lines = {line.split()[0]: line for line in result.out.splitlines()}
    assert {"panda", "iiwa14", "ur5e"} <= set(ListRobots())
    for name in ListRobots():
        robot = LoadRobot(name)
        _, joints, mass, kg, reach, metre, *description = lines[name].split()
        assert int(joints) == len(robot.posture)
        assert kg == "kg"
        assert float(mass) > 10
        assert metre == "m"
        assert 0.7 < float(reach) < 1.0
        assert robot.description.split()[: len(description)] == description
    assert lines["ur5e"].split()[1:3] == ["6", "21.7"]
    assert "--robot" in result.out
    assert "reflected_inertia" not in result.out


def test_missing_picture_of_a_robot_is_found_before_it_is_used(refused, tmp_path):
    urdf = (models_dir() / "ur5e" / "ur5e.urdf").read_text()
    visual = '<visual><geometry><mesh filename="no.obj"/></geometry></visual><inertial>'
    (tmp_path / "mine.urdf").write_text(urdf.replace("<inertial>", visual, 1))
    config = (models_dir() / "ur5e" / "ur5e.yaml").read_text()
    file = tmp_path / "mine.yaml"
    file.write_text(config.replace("ur5e.urdf", "mine.urdf"))
    message = refused("robots", file)
    assert "mine.urdf cannot be read" in message
    assert message.endswith("a model needs no <visual>.\n")


def test_a_robot_that_no_station_can_control_is_listed_with_the_reason(
    command, tmp_path
):
    urdf = (models_dir() / "ur5e" / "ur5e.urdf").read_text()
    urdf = re.sub("<visual>.*?</visual>", "", urdf, flags=re.DOTALL)
    pattern = "<transmission .*?</transmission>"
    motors = re.findall(pattern, urdf, re.DOTALL)[::-1]
    urdf = re.sub(pattern, lambda _: motors.pop(0), urdf, flags=re.DOTALL)
    (tmp_path / "mine.urdf").write_text(urdf)
    config = (models_dir() / "ur5e" / "ur5e.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(config.replace("ur5e.urdf", "mine.urdf"))
    result = command("robots", tmp_path / "mine.yaml")
    assert result.code == 0
    assert "ur5e_joint1. Write the transmissions in the order of" in result.out
    assert "next:" not in result.out


def test_a_robot_of_a_file_is_listed(command, tmp_path):
    model = LoadRobot("ur5e").model
    text = f"""
model: {model}
base: ur5e_link0
flange: ur5e_flange
posture: [-0.245, -1.228, 1.963, -2.306, -1.571, -0.245]
base_pose: {{rpy: [0.0, 0.0, 3.141592653589793]}}
description: Mine.
"""
    (tmp_path / "mine.yaml").write_text(text)
    result = command("robots", tmp_path / "mine.yaml")
    assert result.code == 0
    assert result.out.splitlines()[1].split()[0] == "mine"
    assert "Mine." in result.out
    assert "panda" not in result.out
    assert f"next: fmp-drake wipe --robot {tmp_path / 'mine.yaml'}" in result.out


def test_a_robot_without_shapes_or_that_touches_itself_is_listed_with_the_reason(
    command, tmp_path
):
    folder = models_dir() / "ur5e"
    urdf, text = ((folder / f"ur5e.{end}").read_text() for end in ("urdf", "yaml"))
    bare = re.sub("<collision.*?</collision>", "", urdf, flags=re.DOTALL)
    (tmp_path / "bare.urdf").write_text(bare)
    (tmp_path / "bare.yaml").write_text(text.replace("ur5e.urdf", "bare.urdf"))
    result = command("robots", tmp_path / "bare.yaml")
    assert "has no collision geometry" in result.out
    assert "next:" not in result.out
    text = text.replace("ur5e.urdf", str(folder / "ur5e.urdf"))
    folded = re.sub(r"posture: .*", "posture: [0, -1.2, 2.8, 1.1, -1.57, 0]", text)
    (tmp_path / "folded.yaml").write_text(folded)
    result = command("robots", tmp_path / "folded.yaml")
    assert re.search(r"\w+ and \w+ touch each other in the posture", result.out)


def test_a_mount_with_which_an_arm_reaches_much_farther_is_named(command, tmp_path):
    folder = models_dir() / "ur5e"
    urdf, text = ((folder / f"ur5e.{end}").read_text() for end in ("urdf", "yaml"))
    limit = r'(name="ur5e_joint6".*?<limit )lower="[^"]*" upper="[^"]*"'
    urdf, count = re.subn(limit, r'\1lower="-2" upper="2"', urdf, flags=re.DOTALL)
    assert count == 1
    (tmp_path / "ur5e.urdf").write_text(urdf)
    file, mount = (
        tmp_path / "mine.yaml",
        "mount: {rpy: [0.0, 0.0, -1.5707963267948966]}",
    )
    assert mount in text
    file.write_text(text)
    whole = command("robots", file).out
    assert "mount.rpy" not in whole
    turned = text.replace(mount, "mount: {rpy: [0.0, 0.0, 1.5707963]}")
    file.write_text(turned)
    found = command("robots", file).out
    reach = re.search(r"([\d.]+ m) +A Uni", whole)[1]
    words = "With mount.rpy [0.0, 0.0, -1.5708], the tool turned by 180 degrees on the"
    assert f"{words} flange, the reach would be {reach}." in found
    # It can wipe as it is, too.
    assert f"next: fmp-drake wipe --robot {file}" in found


def test_a_joint_that_is_too_light_is_named_with_the_key_that_mends_it(
    command, tmp_path
):
    text = (models_dir() / "ur5e" / "ur5e.yaml").read_text()
    text = text.replace("ur5e.urdf", str(models_dir() / "ur5e" / "ur5e.urdf"))
    (tmp_path / "light.yaml").write_text(f"{text}\nreflected_inertia: [0]\n")
    result = command("robots", tmp_path / "light.yaml")
    assert result.code == 0
    assert "ur5e_joint6 of ur5e.urdf has an inertia of only" in result.out
    assert "reflected_inertia: [0.1]" in result.out


def test_a_joint_whose_limits_are_too_near_is_named_before_a_run(
    command, refused, tmp_path
):
    """`robots` named the next command, and `check` said that the arm can follow."""
    folder = models_dir() / "ur5e"
    urdf, count = re.subn(
        r'lower="[^"]*" upper="[^"]*"(?=[^<]*</joint>\s*<joint name="ur5e_joint6")',
        'lower="-1.65" upper="-1.5"',
        (folder / "ur5e.urdf").read_text(),
    )
    assert count == 1
    (tmp_path / "ur5e.urdf").write_text(urdf)
    file = tmp_path / "ur5e.yaml"
    file.write_text((folder / "ur5e.yaml").read_text())
    words = (
        "ur5e_joint5 has the limits -1.65 and -1.5 rad; they must be more than 0.2 rad"
    )
    result = command("robots", file)
    assert words in result.out
    assert "next:" not in result.out
    assert words in refused("check", "--robot", file)


@pytest.mark.parametrize(
    ("pattern", "new", "words"),
    [
        (
            r'(ur5e_joint3".*?)lower="[^"]*" upper="[^"]*"',
            r'\1lower="-178" upper="178"',
            "ur5e_joint3 has the limits -178 and 178 rad, more than 10 revolutions; give",
        ),
        (
            '<mass value="([^"]*)"',
            r'<mass value="\1e3"',
            r"ur5e_joint2 of ur5e.urdf needs \d+.\d Nm to hold the weight of 21700.3 kg in",
        ),
    ],
)
def test_values_in_a_wrong_unit_are_named_before_a_run(
    command, refused, tmp_path, pattern, new, words
):
    """The arm was listed; `check` ignored its limits, or said that the board is out of reach."""
    folder = models_dir() / "ur5e"
    urdf = (folder / "ur5e.urdf").read_text()
    urdf, count = re.subn(pattern, new, urdf, flags=re.DOTALL)
    assert count
    (tmp_path / "ur5e.urdf").write_text(urdf)
    file = tmp_path / "ur5e.yaml"
    file.write_text((folder / "ur5e.yaml").read_text())
    result = command("robots", file)
    assert re.search(words, result.out)
    assert "next:" not in result.out
    assert re.search(words, refused("check", "--robot", file))


def test_an_unknown_robot_is_refused_with_the_known_ones(refused):
    assert "iiwa14, panda, ur5e" in refused("check", "--robot", "billiards")


def test_mistake_in_the_file_of_a_robot_is_found_before_learning(refused, tmp_path):
    text = (models_dir() / "ur5e" / "ur5e.yaml").read_text()
    text = text.replace("ur5e.urdf", str(models_dir() / "ur5e" / "ur5e.urdf"))
    text = text.replace("[ur5e_link0, ur5e_link1]", "[ur5e_link0, nothing]")
    (tmp_path / "mine.yaml").write_text(text)
    # The recording, which does not exist, would be refused next.
    recording = ("--demo", tmp_path / "missing.csv", "--surface", "fitted")
    for command in ("check", "wipe"):
        words = refused(command, *recording, "--robot", tmp_path / "mine.yaml")
        assert "contact_free names nothing" in words


def test_another_robot_is_checked_with_its_own_posture(command, tmp_path):
    report = tmp_path / "check.json"
    # The scenario's posture is one of seven joints.
    result = command(
        "check", "--scenario", "vertical", "--robot", "ur5e", "--report", report
    )
    assert result.code in (0, 1)
    values = json.loads(report.read_text())
    result = command("check", "--robot", "ur5e")
    assert result.code == 0
    assert "The arm can follow" in result.out
    assert values["smallest_joint_margin"] >= 0


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "--arm", "lcm", "--robot", "iiwa14"),
        ("record", "--arm", "lcm", "--robot", "ur5e", "--out", "x.npz"),
    ],
)
def test_arm_behind_panda_messages_must_be_a_panda(refused, arguments):
    assert "is simulated only; the arm behind LCM is a Panda" in refused(*arguments)


def test_an_arm_that_reaches_no_table_is_listed_all_the_same(command, tmp_path):
    text = (models_dir() / "panda" / "panda.yaml").read_text()
    urdf = next((models_dir() / "panda").glob("*.urdf"))
    text = text.replace(urdf.name, str(urdf))
    pose = "base_pose: {translation: [0, 0, 1.9], rpy: [3.141592653589793, 0, 0]}"
    text = "\n".join(row for row in text.splitlines() if "base_pose" not in row)
    (tmp_path / "ceiling.yaml").write_text(f"{text}\n{pose}\n")
    result = command("robots", tmp_path / "ceiling.yaml")
    assert result.code == 0
    assert result.out.splitlines()[1].split()[:5] == [
        "ceiling",
        "7",
        "16.7",
        "kg",
        "none",
    ]
    assert "cannot hold the eraser level anywhere" in result.out
