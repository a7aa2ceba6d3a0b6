"""Options of commands, declared as the fields of dataclasses.

A command takes one argument for each group of options::

    @command({"fmp-drake wipe --headless": "no page"})
    def wipe(play: PlayOptions, page: PageOptions) -> None: ...
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import wraps
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import click
import numpy as np

from fmp_drake.errors import FmpError
from fmp_drake.numeric import check_number
from fmp_drake.primitives import FourierMovementPrimitive, ReadingOptions
from fmp_drake.primitives.data.channels import FORCE_CHANNEL
from fmp_drake.skills.surface_fit import SHAPES
from fmp_drake.skills.surface_placement import EXTRA_CHANNELS
from fmp_drake.station import LoadRobot, LoadScenario, Scenario
from fmp_drake.station.robots.robot import MakeRobotModel


class _PathType(click.Path):
    """Path that is not empty: as a path, "" is the current folder."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "":
            self.fail("the name is empty", param, ctx)
        return super().convert(value, param, ctx)


PATH = _PathType(path_type=Path)
"""Type of an argument that is a path."""

SKILL_FLAGS = ("--skill-file", "--skill")
"""Names of an option for a skill file."""

_LIMITS = ("above", "least", "most")
# Greatest number of options in the short help of a command.
_MOST_OPTIONS = 12
# Former names of options, which still work, and their present names.
_FORMER = {
    "--components": "--n-components",
    "--hand": "--task",
    "--no-torque": "--dry",
    "--page": "--markdown",
    "--rate": "--target-realtime-rate",
    "--seconds": "--duration",
    "--with": "--extra",
}


class _GroupedOption(click.Option):
    """Option in a group of the help.

    Parameters
    ----------
    group : str
        Title of the group.
    basic : bool
        Whether ``--help`` shows it even in a long list.
    """

    def __init__(
        self, *args: Any, group: str, basic: bool = True, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.group, self.is_basic = group, basic


class Command(click.Command):
    """Command whose help has examples, and options in groups.

    If it has more than 12 options, ``--help`` shows the basic ones and ``--help-all`` all.

    Parameters
    ----------
    examples : mapping from str to str
        Command lines, each with its purpose.
    """

    def __init__(self, *args: Any, examples: Mapping[str, str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        # The first missing parameter is reported: an argument before an option.
        self.params.sort(key=lambda parameter: isinstance(parameter, click.Option))
        self._examples = examples
        count = sum(isinstance(parameter, _GroupedOption) for parameter in self.params)
        self._has_more = count > _MOST_OPTIONS
        if self._has_more:
            show_all = click.Option(
                ["--help-all"],
                is_flag=True,
                is_eager=True,
                expose_value=False,
                callback=_show_all,
                help=f"Show all {count} options.",
            )
            self.params.append(show_all)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments, with the present names in place of former ones."""
        names = {name for parameter in self.params for name in parameter.opts}
        renamed = []
        for arg in args:
            name, equals, value = arg.partition("=")
            present = _FORMER.get(name)
            is_former = name not in names and present in names
            renamed.append(f"{present}{equals}{value}" if is_former else arg)
        return super().parse_args(ctx, renamed)

    def format_options(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write the options in their groups."""
        groups: dict[str, list[tuple[str, str]]] = {}
        others = []
        is_short = self._has_more and not ctx.meta.get(_SHOW_ALL)
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None or isinstance(parameter, click.Argument):
                continue
            if not isinstance(parameter, _GroupedOption):
                others.append(record)
            elif parameter.is_basic or not is_short:
                groups.setdefault(parameter.group, []).append(record)
        for title, records in [*groups.items(), ("Help", others)]:
            with formatter.section(title):
                formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        super().format_epilog(ctx, formatter)
        with formatter.section("Examples"):
            for line, purpose in self._examples.items():
                formatter.write(f"  # {purpose}\n  {line}\n")


_SHOW_ALL = "fmp_drake.show_all"


def _show_all(context: click.Context, _parameter: click.Parameter, value: bool) -> None:
    """Print the help with all options, and exit."""
    if value:
        context.meta[_SHOW_ALL] = True
        click.echo(context.get_help())
        context.exit()


def option(default: Any = MISSING, help: str | None = None, **details: Any) -> Any:
    """Return a field of a dataclass that is an option of a command.

    The annotation of the field is the type of the value: a `Literal` for a choice, a tuple
    of numbers, or ``tuple[type, ...]`` for an option that may be repeated.

    Parameters
    ----------
    default : object
        Default value; without it the option is required.
    help : str
        Text of ``--help``.
    details
        Other arguments of `click.Option`; ``flags`` are the names on the command line if
        they differ from the name of the field; ``above``, ``least`` and ``most`` are the
        limits of a number.
    """
    return field(default=default, metadata={"help": help, **details})


def command(
    examples: Mapping[str, str],
) -> Callable[[Callable[..., None]], Command]:
    """Return a decorator that makes a function a command.

    Each argument of the function that is a dataclass becomes a group of options, with
    the first line of the dataclass's docstring as its title.

    Parameters
    ----------
    examples : mapping from str to str
        Command lines for the help, each with its purpose.
    """

    def decorate(function: Callable[..., None]) -> Command:
        hints = get_type_hints(function)
        groups: dict[str, Any] = {n: t for n, t in hints.items() if is_dataclass(t)}

        @wraps(function)
        def run(**values: Any) -> None:
            for name, group in groups.items():
                settings = {f.name: values.pop(f.name) for f in fields(group)}
                for item in fields(group):
                    limits = {k: v for k, v in item.metadata.items() if k in _LIMITS}
                    if limits and (value := settings[item.name]) is not None:
                        check_number(value, item.name, error=FmpError, **limits)
                values[name] = group(**settings)
            function(**values)

        for group in reversed(groups.values()):
            hints = get_type_hints(group)
            title = (group.__doc__ or "").partition(".\n")[0].strip().rstrip(".")
            for item in reversed(fields(group)):
                run = _click_option(item, hints[item.name], title)(run)
        return click.command(cls=Command, examples=examples)(run)

    return decorate


def _click_option(item: Field[Any], hint: Any, group: str) -> Callable[..., Any]:
    """Return click's option for a field of a dataclass."""
    others = {"flags", *_LIMITS}
    details = {k: v for k, v in item.metadata.items() if k not in others}
    is_optional = NoneType in get_args(hint)
    kind = get_args(hint)[0] if is_optional else hint
    parts = get_args(kind) or (kind,)
    if get_origin(kind) is Literal:
        details["type"] = click.Choice(parts)
    elif kind is bool:
        details["is_flag"] = True
    else:
        details.setdefault("type", PATH if parts[0] is Path else parts[0])
        if Ellipsis in parts:
            details["multiple"] = True
        else:
            details["nargs"] = len(parts)
    if item.default is MISSING:
        details["required"] = True
    else:
        details["default"] = item.default
        is_shown = item.default not in (None, "", ()) and item.default is not False
        details["show_default"] = is_shown
    names = (*_flags(item), item.name)
    return click.option(*names, cls=_GroupedOption, group=group, **details)


def _flags(item: Field[Any]) -> Sequence[str]:
    """Return the names on the command line of a field."""
    flags: Sequence[str] = item.metadata.get(
        "flags", ["--" + item.name.replace("_", "-")]
    )
    return flags


def arguments(*groups: Any) -> list[str]:
    """Return the arguments of a command line that set groups of options to their values."""
    out: list[str] = []
    for group in groups:
        hints = get_type_hints(type(group))
        for item in fields(group):
            value = getattr(group, item.name)
            if value == item.default:
                continue
            flag = _flags(item)[-1]
            values = value if isinstance(value, tuple) else (value,)
            if value is True:
                out.append(flag)
            elif Ellipsis in get_args(hints[item.name]):  # It may be repeated.
                out += [text for v in values for text in (flag, str(v))]
            else:
                out += [flag, *map(str, values)]
    return out


def host_option() -> Any:
    """Return the field for the address of the page."""
    return option(
        "localhost",
        "Address of this machine at which the page is served; 0.0.0.0 for all of them. "
        "Anyone who can reach it can watch; control requires the printed address.",
        basic=False,
    )


def arm_option(text: str) -> Any:
    """Return the field for an arm that another process drives or simulates."""
    return option(
        None,
        f"{text} Values: lcm or lcm:URL (LCM messages), or a YAML file.",
        metavar="ARM",
    )


def real_time_option() -> Any:
    """Return the field that requests real-time scheduling."""
    return option(
        False,
        "With an arm: real-time scheduling (SCHED_FIFO, locked memory).",
        basic=False,
    )


@dataclass(frozen=True, kw_only=True)
class ScenarioOptions:
    """Scene and robot."""

    scenario: str = option(
        "table_top",
        "Name of a scenario (see `fmp-drake scenarios`), or a YAML file.",
    )
    robot: str | None = option(
        None,
        "Name of a robot that replaces the scenario's (see `fmp-drake robots`), or a YAML "
        "file.",
        basic=False,
    )

    def load(self) -> Scenario:
        """Return the scenario; mistakes in its arm and tool are found before learning."""
        scenario = LoadScenario(self.scenario, robot=self.robot)
        MakeRobotModel(LoadRobot(scenario.robot), scenario.held_tool())
        return scenario


@dataclass(frozen=True, kw_only=True)
class SceneOptions(ScenarioOptions):
    """Skill and scene."""

    demonstrations: tuple[Path, ...] = option(
        (),
        "Learn from this recording instead of the scenario's; may be repeated.",
        flags=("--demonstration", "--demo"),
    )
    skill_file: Path | None = option(
        None, "Play this skill file (.npz) instead.", flags=SKILL_FLAGS
    )
    tempo: float | None = option(
        None,
        "Tempo of the movement; 1 is as demonstrated [default: the scenario's].",
        least=0,
    )
    press_force: float | None = option(
        None, "Normal force on the board, N [default: the scenario's].", basic=False
    )
    start: tuple[float, float, float] | None = option(
        None,
        "Start of the eraser in the frame of the board, m; z is the height above it.",
        metavar="X Y Z",
        basic=False,
    )
    move_board: tuple[float, float, float] | None = option(
        None,
        "Displacement of the board from its place in the scenario, in the world frame, m.",
        metavar="X Y Z",
        basic=False,
    )

    def load(self) -> Scenario:
        """Return the scenario, changed by these options; wrong values are found before learning."""
        scenario = super().load()
        if self.move_board is not None:
            moved = np.add(scenario.board.translation, self.move_board)
            scenario.board.translation = moved.tolist()
        if self.start is not None:
            scenario.start = list(self.start)
        if self.tempo is not None:
            scenario.skill.tempo = self.tempo
        if self.press_force is not None:
            scenario.press.force = self.press_force
        scenario.check()
        return scenario

    def check(self, scenario: Scenario, skill: FourierMovementPrimitive) -> None:
        """Refuse a normal force where another one is played, or none."""
        if self.press_force is None:
            return
        if not scenario.has_board:
            raise FmpError(
                "there is no board in this scenario; leave out --press-force."
            )
        if FORCE_CHANNEL in skill.channels_:
            raise FmpError(
                "the skill has its own normal force, in its channel "
                f"{FORCE_CHANNEL}; leave out --press-force."
            )


@dataclass(frozen=True, kw_only=True)
class LearningOptions:
    """Learning."""

    n_components: int | None = option(
        None,
        "Gaussians in the mixture [default: 80, fewer for short recordings].",
        basic=False,
    )
    window: float | None = option(
        None,
        "Length of a window, s: one or more periods [default: 6 for a scenario's own "
        "demonstration; otherwise it follows the period, up to 6, or 1.2 periods if they "
        "are longer].",
        basic=False,
    )
    stretch: float = option(
        1.0,
        "Factor that slows a recording down before it is learned; --tempo changes the "
        "playback instead.",
        basic=False,
    )
    transform: tuple[float, float, float, float, float, float] | None = option(
        None,
        "Pose of the demonstration's frame in the board's (m, rad), instead of fitting "
        "its plane and placing it in the middle of the board.",
        metavar="X Y Z ROLL PITCH YAW",
        basic=False,
    )
    surface: str | None = option(
        None,
        "Surface to fit to the contact of the recordings, which becomes the board: of the "
        "shape that fits best, or of a fixed shape.",
        basic=False,
        type=click.Choice(["fitted", *SHAPES]),
    )
    extra: tuple[str, ...] = option(
        (),
        "Channels to learn besides x, y and z, relative to the surface (or as recorded); may "
        "be repeated.",
        basic=False,
        type=click.Choice(EXTRA_CHANNELS),
    )


@dataclass(frozen=True, kw_only=True)
class RhythmOptions:
    """Part and period of recordings."""

    start_time: float | None = option(
        None, "Start of the part to learn from, s.", flags=("--start-time", "--from")
    )
    end_time: float | None = option(
        None, "End of the part to learn from, s.", flags=("--end-time", "--to")
    )
    period: float | None = option(
        None, "Duration of a cycle, s [default: from the recording]."
    )


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """Information that recordings lack."""

    columns: str = option(
        "",
        "Columns to read, by name or number: time=stamp [ms],x=2,y=3.",
        metavar="NAME=COLUMN,...",
        basic=False,
    )
    unit: str = option("", "Unit of positions: m, cm, mm ...", basic=False)
    sample_rate: float | None = option(
        None, "Sample rate of a recording without times, Hz.", basic=False
    )
    topic: str = option(
        "",
        "Topic of a bag (several: /pose,/wrench), feature of a dataset, or sensor of a table of "
        "several.",
        basic=False,
    )
    quaternions: Literal["xyzw", "wxyz"] | None = option(
        None,
        "Order of the elements of quaternions without names [default: the order that "
        "agrees with recorded joint angles, otherwise xyzw].",
        basic=False,
    )

    def reading(self) -> ReadingOptions:
        """Return the options for the readers of recordings."""
        return ReadingOptions.parse(**vars(self))
