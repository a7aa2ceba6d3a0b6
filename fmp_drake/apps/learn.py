"""`fmp-drake learn`."""

import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from pydrake.common.yaml import yaml_dump_typed

from fmp_drake.apps.options import (
    PATH,
    LearningOptions,
    RecordingOptions,
    RhythmOptions,
    command,
    option,
)
from fmp_drake.apps.page import make_console, print_next
from fmp_drake.errors import FmpError
from fmp_drake.plots import plot_skill
from fmp_drake.plots.style import check_picture
from fmp_drake.primitives import FourierMovementPrimitive, save_skill
from fmp_drake.primitives.data.channels import POSITION_CHANNELS, ROTATION_CHANNELS
from fmp_drake.primitives.data.files import check_writable, write_text
from fmp_drake.primitives.model.movement_primitive import ModelChoice
from fmp_drake.skills import learn_skill
from fmp_drake.skills.description import skill_in_words, source_in_words
from fmp_drake.skills.loading import load_as_recorded, load_on_board
from fmp_drake.skills.surface_placement import ROTATIONAL_STIFFNESS
from fmp_drake.station import Scenario
from fmp_drake.station.robots.robot import DEFAULT_ROBOT

_POSE = {*POSITION_CHANNELS, *ROTATION_CHANNELS}


@dataclass(frozen=True, kw_only=True)
class LearnOptions:
    """Model, and files to write."""

    out: Path = option(help="Skill file (.npz) to write.")
    plot: Path | None = option(None, "Picture of the skill.")
    board: Path | None = option(
        None,
        "Scenario (.yaml) to write, with the skill and the board that --surface fits.",
        basic=False,
    )
    model: ModelChoice | None = option(
        None,
        "Model of the movement: Gaussians over windows, its phase, or its phase where "
        "that can be tracked [default: "
        f"{FourierMovementPrimitive().model}].",
    )
    robot: str | None = option(
        None,
        "Robot of recorded joint angles: its name (see `fmp-drake robots`), or a YAML file "
        f"[default: as the joints are named, or {DEFAULT_ROBOT}].",
        basic=False,
    )
    as_recorded: bool = option(
        False,
        "Learn all channels unchanged, instead of x, y and z on the board.",
    )


@command(
    {
        "fmp-drake learn mine.csv --out skill.npz": "learn a movement on the board",
        "fmp-drake learn a.csv b.csv --out skill.npz": "two recordings of one movement",
        "fmp-drake learn car.npz --surface fitted --extra orientation --out skill.npz "
        "--board car.yaml": "poses on a surface fitted to the recording",
    }
)
@click.argument("demonstrations", nargs=-1, required=True, type=PATH)
def learn(
    demonstrations: tuple[Path, ...],
    skill: LearnOptions,
    learning: LearningOptions,
    rhythm: RhythmOptions,
    recording: RecordingOptions,
) -> None:
    """Learn a skill from DEMONSTRATIONS (tables, bags ...) and write it to a file."""
    console = make_console()
    check_writable(skill.out, "a skill", [".npz"])
    if os.path.realpath(skill.out) in map(os.path.realpath, demonstrations):
        raise FmpError(f"{skill.out} is the recording; give the skill its own file.")
    if skill.as_recorded and (learning.transform or learning.surface):
        raise FmpError(
            "--as-recorded places nothing; leave out --transform and --surface."
        )
    check_picture(skill.plot)
    check_writable(skill.board, "a scenario", [".yaml", ".yml"])
    if skill.as_recorded and skill.board is not None:
        raise FmpError("with --as-recorded there is no board; leave out --board.")
    if skill.as_recorded and skill.robot is not None:
        raise FmpError(
            "with --as-recorded the joint angles themselves are learned; leave out --robot."
        )
    scenario = Scenario()
    if skill.robot is not None:
        is_file = Path(skill.robot).is_file()
        scenario.robot = str(Path(skill.robot).resolve()) if is_file else skill.robot
        scenario.check()
    # Its times are those of the recording.
    part: dict[str, Any] = {
        name: None if value is None else learning.stretch * value
        for name, value in vars(rhythm).items()
    }
    if skill.as_recorded:
        recordings, remarks = load_as_recorded(
            demonstrations,
            stretch=learning.stretch,
            reading=recording.reading(),
            extra=learning.extra,
        )
    else:
        recordings, remarks = load_on_board(
            demonstrations,
            scenario=scenario,
            transform=learning.transform,
            stretch=learning.stretch,
            reading=recording.reading(),
            needs_board=False,
            surface=learning.surface,
            extra=learning.extra,
            **part,
        )
        if learning.surface is not None:  # They are the bouts of that part.
            part = {"period": part["period"]}
    for remark in remarks:
        console.print(remark, soft_wrap=True)
    start = time.perf_counter()
    with console.status("learning") as status:
        learned = learn_skill(
            recordings,
            window=learning.window,
            n_components=learning.n_components,
            model=skill.model,
            **part,
            by_position=learning.surface is not None,
            progress=status.update,
        )
    console.print(
        f"learned {source_in_words(learned)} in {time.perf_counter() - start:.2f} s"
    )
    bouts = 0 if learning.surface is None else len(recordings)
    for sentence in _sentences(learned, bouts):
        console.print(sentence)
    save_skill(learned, skill.out)
    console.print(f"wrote {skill.out}")
    if skill.plot is not None:
        plot_skill(learned, recordings, skill.plot)
        console.print(f"wrote {skill.plot}")
    if skill.board is not None:
        scenario.skill.file = os.path.relpath(skill.out, skill.board.parent)
        text = yaml_dump_typed(scenario, defaults=Scenario())  # type: ignore[no-untyped-call]
        write_text(skill.board, text)
        console.print(f"wrote {skill.board}")
        print_next(console, "wipe", "--scenario", str(skill.board))
    elif learning.surface is not None:
        console.print(
            "the fitted board is not in the skill: repeat this with --board board.yaml, which "
            "also holds the controller's settings for force and orientation",
            soft_wrap=True,
        )
    elif not {*POSITION_CHANNELS} <= {*learned.channels_}:
        return
    elif skill.as_recorded and {*learned.channels_} <= _POSE:
        console.print(_free_scenario(learned, skill.out), soft_wrap=True)
    elif not skill.as_recorded:
        # Poses that are not relative to a surface are played in free space.
        has_poses = ROTATION_CHANNELS[0] in learned.channels_
        in_free_space = has_poses and "orientation" not in learning.extra
        scene = ["--scenario", "stir"] if in_free_space else []
        scene += [] if skill.robot is None else ["--robot", skill.robot]
        print_next(console, "wipe", *scene, "--skill", str(skill.out))


def _sentences(skill: FourierMovementPrimitive, bouts: int) -> Iterator[str]:
    """Yield sentences about a skill, learned from a number of bouts on a surface, or 0."""
    for sentence in skill_in_words(skill):
        if not bouts or not sentence.startswith("left out:"):
            yield sentence
        elif bouts > 1:  # Of one, the remarks have the times of the recording.
            yield (
                f"{sentence.replace('of recording', 'of bout')} (bouts are counted over all "
                "recordings, each from 0 s)"
            )


def _free_scenario(skill: FourierMovementPrimitive, path: Path) -> str:
    """Return how to play a skill of poses in the frame of the robot's base."""
    columns = [skill.channels_.index(name) for name in POSITION_CHANNELS]
    middle = skill.extent_[:, columns].mean(axis=0)
    start = ", ".join(f"{round(float(number), 3) + 0:g}" for number in middle)
    lines = [
        (
            "to play it in free space, if its frame is that of the robot's base, write these "
            "lines to free.yaml (for another frame, or a robot with a base_pose, such as a "
            "ur5e, set board.translation and board.rpy to its pose in the world):"
        ),
        "  board: {shape: none, translation: [0.0, 0.0, 0.0]}",
        f"  start: [{start}]",
    ]
    if ROTATION_CHANNELS[0] in skill.channels_:
        stiffness = [ROTATIONAL_STIFFNESS] * 3
        lines.append(f"  impedance: {{rotational_stiffness: {stiffness}}}")
    lines.append(f"  skill: {{file: {json.dumps(str(path.resolve()))}}}")
    return "\n".join(lines)
