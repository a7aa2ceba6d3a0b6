"""Session of kinesthetic teaching: demonstrate, learn, play, demonstrate again."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from fmp_drake.errors import FmpError, RunError
from fmp_drake.numeric import Array, as_path
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, save_skill
from fmp_drake.primitives.data.demonstration import check_ending
from fmp_drake.primitives.data.files import (
    check_writable,
    is_numbered,
    keep_earlier_files,
    numbered,
)
from fmp_drake.primitives.data.windows import DEFAULT_RATE
from fmp_drake.primitives.model.movement_primitive import ModelChoice
from fmp_drake.runs.guided_demonstrations import guided_demonstrations, hand_time
from fmp_drake.runs.station_run import MakeRun, StationRun, WipingRun
from fmp_drake.skills import learn_skill
from fmp_drake.station import CheckFeasibility, MakeStation, Scenario
from fmp_drake.station.external_forces import TeachingHand
from fmp_drake.station.page import BOARD
from fmp_drake.station.scenario import check_scenario
from fmp_drake.systems import PagePanel, draw_demonstrations
from fmp_drake.systems.ink.grid import cleaned_fraction
from fmp_drake.systems.mouse_hand import TURN_SWITCH
from fmp_drake.systems.page.paths import draw_rod
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR

Mode = Literal["teach", "play"]

BUTTONS: dict[Mode, tuple[str, ...]] = {
    "teach": ("learn", "again", "play", "save"),
    "play": ("teach", "more", "save"),
}
"""Buttons of each mode."""

# Shortest recording that can be learned, windows.
_MIN_WINDOWS = 2
# Largest lag behind the clock for which a simulation catches up, s.
_MAX_LAG = 0.2
# Real-time rate below which a machine is slow, and duration of its measurement, s.
_SLOW_RATE, _RATE_TIME = 0.9, 3.0
# Rotation above which a demonstration has an orientation, rad.
_MIN_ROTATION = 0.1
# Number of samples in a part of the drawing.
_CHUNK = 20


def check_names(scenario: Scenario, out: Path, skill_file: Path) -> None:
    """Raise an error where a session cannot write its files with these names.

    Raises
    ------
    FmpError
        Where the skill has no folder, a demonstration would replace it, or an ending is
        wrong.
    """
    check_ending(out, has_rotation=not scenario.has_board)
    check_writable(skill_file, "a skill", [".npz"])
    if is_numbered(skill_file, out):
        raise RunError(
            f"{skill_file} is also the name of a demonstration; give the skill another one."
        )


class TeachingSession:
    """Session of kinesthetic teaching: a hand guides an arm, which learns and plays a skill.

    A page or a program presses the buttons of the session. In the mode `teach` a hand
    guides the arm, and its motion is recorded. In the mode `play` the arm plays the
    learned skill from its current pose, and may be pulled. The arm does not jump between
    the modes.

    Buttons:

    - *learn*: learn from the recorded motion, and play the skill;
    - *again*: discard the motion recorded since the last learning;
    - *undo*: restore the motion that *again* has discarded;
    - *play*: play the last skill;
    - *teach*: start a new skill;
    - *more*: learn also from the motion of an arm that was pulled during play; without
      such a motion, record another demonstration, to be learned together with the others;
    - *save*: write the demonstrations and the skill to files. Earlier files with these
      names are renamed.

    Parameters
    ----------
    scenario : Scenario
    hand : TeachingHand
        A `MouseOnPage`, for example.
    panel : PagePanel, optional
        Page of the session.
    clock : callable, optional
        Returns the time, s. The simulation is synchronised with it, and it determines the
        times of the recording. None to simulate as fast as possible.
    out, skill_file : Path
        Files for *save*: the demonstrations (numbered from the second one) and the skill.

    Attributes
    ----------
    mode : {'teach', 'play'}
    simulator : Simulator
        Of the station of the current mode.
    skill : FourierMovementPrimitive or None
        The last learned skill.
    remark : str
        Result of the last button.
    is_done : bool
        Whether the last button had its effect, without a warning.
    suggested_tempo : float or None
        Slower tempo for a skill that the arm cannot follow, if there is one.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario, SimulatedHand
    >>> from fmp_drake.systems import HandMotion
    >>> hand = SimulatedHand(HandMotion.make("eight", duration=20.0, seed=0))
    >>> session = TeachingSession(LoadScenario("table_top"), hand, clock=None)
    >>> session.advance(0.2)
    >>> session.press("learn")
    >>> session.mode, session.remark
    ('teach', 'show 12 s more: learning needs at least two windows of 6 s')
    """

    def __init__(
        self,
        scenario: Scenario,
        hand: TeachingHand,
        *,
        panel: PagePanel | None = None,
        clock: Callable[[], float] | None = time.monotonic,
        out: Path = Path("taught.npz"),
        skill_file: Path = Path("taught_skill.npz"),
    ) -> None:
        self._scenario, self._hand, self._panel = scenario, hand, panel
        self._meshcat = None if panel is None else panel.meshcat
        self._clock = clock
        check_scenario(scenario, "TeachingSession(scenario, hand)")
        out = as_path(out, "out", error=RunError)
        skill_file = as_path(skill_file, "skill_file", error=RunError)
        check_names(scenario, out, skill_file)
        self._out, self._skill_file = out, skill_file
        self.skill: FourierMovementPrimitive | None = None
        self.remark, self.is_done = "", True
        self.suggested_tempo: float | None = None
        self._earlier: list[Demonstration] = []
        self._learned: list[Demonstration] = []
        self._discarded: list[tuple[Any, ...]] = []
        self._saved: tuple[Any, ...] = ()
        self._saved_files = ""
        self._surface = scenario.board.curvature()
        self._run: StationRun | None = None
        self._samples: list[tuple[Any, ...]] = []
        self._lag, self._drawn = 0.0, 0
        self._teach(None)

    @property
    def mode(self) -> Mode:
        """Mode of the arm: `teach` while it is guided, `play` while it plays."""
        return "teach" if self._run is None else "play"

    @property
    def buttons(self) -> tuple[str, ...]:
        """Buttons that may be pressed now."""
        undo = ("undo",) if self._discarded else ()
        return (*BUTTONS[self.mode], *undo)

    @property
    def is_guided(self) -> bool:
        """Whether the arm is guided or pulled at the moment."""
        return bool(self._output("is_guided")[0])

    @property
    def missing(self) -> float:
        """Duration of the motion that is missing for learning, s; 0 for none."""
        return self._missing(self.demonstrations)

    @property
    def requirement(self) -> str:
        """What is still to be shown before learning; empty if nothing is missing."""
        return self._requirement(self.demonstrations)

    @property
    def progress(self) -> float:
        """Recorded fraction of the motion that learning needs, from 0 to 1."""
        return 1 - self.missing / (_MIN_WINDOWS * self._scenario.skill.window)

    @property
    def demonstrations(self) -> list[Demonstration]:
        """All demonstrations that were not discarded, in the frame of the board."""
        return [*self._earlier, *self.shown]

    @property
    def shown(self) -> list[Demonstration]:
        """Demonstrations since the start of the mode, or since the last *again*."""
        if not self._samples:
            return []
        samples = np.array(self._samples, dtype=float)
        return guided_demonstrations(
            hand_time(samples[:, 0], samples[:, 1]),
            samples[:, 2:5],
            samples[:, 5],
            frame_seconds=float(self._output("cursor_interval")[0]),
            note=f"shown by hand: {type(self._hand).__name__}; simulated arm",
            orientation=samples[:, 6:] if self._has_rotation(samples) else None,
            reference=Rotation.from_matrix(
                self._scenario.eraser_orientation().matrix()
            ),
        )

    def _has_rotation(self, samples: Array) -> bool:
        """Return whether the tool rotates, as in the earlier demonstrations, if any."""
        if self._earlier:
            return self._earlier[0].rotation_reference is not None
        if samples.shape[1] == 6:
            return False
        R_BE = Rotation.from_quat(samples[:, [7, 8, 9, 6]])
        return bool(np.max((R_BE[0].inv() * R_BE).magnitude()) > _MIN_ROTATION)

    @property
    def file_names(self) -> str:
        """Names of the files of *save*."""
        return f"{self._out.name} and {self._skill_file.name}"

    # Time -----------------------------------------------------------------------------

    def advance(self, seconds: float) -> None:
        """Simulate and record for a duration, s."""
        context = self.simulator.get_context()
        end = context.get_time() + seconds
        while (now := context.get_time()) < end - 1e-9:
            sample_time = (np.floor(now * DEFAULT_RATE + 1e-6) + 1) / DEFAULT_RATE
            until = float(min(sample_time, end))
            if self._run is None:
                self.simulator.AdvanceTo(until)
            else:
                self._run.advance_to(until)
            if until > sample_time - 1e-6 / DEFAULT_RATE:
                self._record()

    def _record(self) -> None:
        now = self.simulator.get_context().get_time()
        clock = now if self._clock is None else self._clock()
        position = self._output(self._position)
        pose = () if self._scenario.has_board else self._output("measured_pose")[:4]
        self._samples.append((now, clock, *position, self.is_guided, *pose))
        lag = (clock - self._samples[0][1]) - (now - self._samples[0][0])
        if self._clock is not None and lag - self._lag > _MAX_LAG:
            self.simulator.ResetStatistics()
            self._lag = lag
        if self._run is None:
            self._draw()

    @property
    def realtime_rate(self) -> float:
        """Simulated seconds per second of the clock, over the last 3 s."""
        last = self._samples[-1:]
        samples = [s for s in self._samples[-200:] if s[1] > last[0][1] - _RATE_TIME]
        if len(samples) < _CHUNK or samples[-1][1] <= samples[0][1]:
            return 1.0
        return (samples[-1][0] - samples[0][0]) / (samples[-1][1] - samples[0][1])

    # Buttons --------------------------------------------------------------------------

    def press(self, button: str) -> None:
        """Press a button; `remark` then describes the result.

        Raises
        ------
        RunError
            If there is no such button in this mode.
        """
        if button not in self.buttons:
            raise RunError(
                f"there is no button {button!r} in the mode {self.mode}; press one of: "
                f"{', '.join(self.buttons)}."
            )
        self.remark, self.is_done = "", True
        try:
            getattr(self, f"_press_{button}")()
        except FmpError as error:
            self.remark, self.is_done = str(error), False

    def _press_learn(self) -> None:
        self._learn(self.demonstrations)

    def _press_again(self) -> None:
        if not self.shown:
            raise RunError("nothing was demonstrated yet: there is nothing to discard")
        samples = self._samples
        self._clear_samples()
        self._discarded = samples
        self.remark = "discarded; undo restores it"

    def _press_undo(self) -> None:
        samples = [*self._discarded, *self._samples]
        self._clear_samples()
        self._samples, self._drawn = samples, len(samples) - 1
        for i, demonstration in enumerate(self.shown):
            self._draw_path(f"undone_{i}", demonstration.values[:, :3])
        self.remark = "restored"

    def _press_play(self) -> None:
        if self.skill is None:
            raise RunError("there is no skill yet: learn first")
        if self.shown:
            raise RunError(
                "the demonstration would be lost: learn it, or discard it with again"
            )
        self._play(self.skill, self._learned)

    def _press_teach(self) -> None:
        self._earlier = []
        self._teach(self._joint_angles())

    def _press_more(self) -> None:
        window = self._scenario.skill.window
        recordings = [d for d in self.shown if d.duration >= window]
        if recordings:
            self._learn([*self._earlier, *recordings])
        else:
            self._teach(self._joint_angles())
            self.remark = (
                "move the arm; the motion is learned together with the earlier one"
            )

    def _press_save(self) -> None:
        demonstrations = self.demonstrations if self._run is None else self._earlier
        # Without a new movement the demonstrations of the skill are written.
        demonstrations = demonstrations or self._learned
        content = (self.skill, [d.values.tobytes() for d in demonstrations])
        if self.skill is None and not demonstrations:
            raise RunError("there is nothing to save yet: show a movement first")
        if content == self._saved:
            self.remark = f"saved already: {self._saved_files}"
            return
        earlier_files = keep_earlier_files(self._out, self._skill_file)
        paths = numbered(self._out, len(demonstrations))
        for path, demonstration in zip(paths, demonstrations, strict=True):
            demonstration.save(path)
        if self.skill is not None:
            save_skill(self.skill, self._skill_file)
            paths.append(self._skill_file)
        self._saved = content
        self._saved_files = ", ".join(path.name for path in paths)
        self.remark = f"wrote {self._saved_files}"
        if self.skill is not None and demonstrations != self._learned:
            self.remark += (
                f"; {self._skill_file.name} was learned from an earlier motion"
            )
        if earlier_files:
            self.remark += f"; the earlier files are {', '.join(earlier_files)} now"

    # Modes ----------------------------------------------------------------------------

    def _learn(self, demonstrations: list[Demonstration]) -> None:
        """Learn and play a skill; an error changes nothing."""
        window = self._scenario.skill.window
        if requirement := self._requirement(demonstrations):
            raise RunError(
                f"{requirement}: learning needs at least two windows of {window:g} s"
            )
        started = time.perf_counter()
        skill = learn_skill(
            demonstrations,
            window=window,
            n_components=self._scenario.skill.n_components,
            model=cast(ModelChoice, self._scenario.skill.model),
        )
        self._play(skill, demonstrations)
        self.remark = f"learned in {time.perf_counter() - started:.1f} s"
        if skill.phase_model_ is None:
            self.remark += (
                "; no cycle was found: press more, and repeat the same movement"
            )
            self.is_done = False
        # It starts where the eraser is, which may be in the felt.
        x, y, z = map(float, self._output(self._position))
        start = [x, y, max(z, 0.0) if self._scenario.has_board else z]
        feasibility = CheckFeasibility(replace(self._scenario, start=start), skill)
        self.suggested_tempo = feasibility.suggested_tempo
        if not feasibility.is_feasible:
            self.remark += f"; {feasibility.verdict}"
            self.is_done = False

    def _missing(self, demonstrations: Sequence[Demonstration]) -> float:
        """Return the duration of the motion that is missing for learning, s."""
        window = self._scenario.skill.window
        lengths = [d.duration + 1 / DEFAULT_RATE for d in demonstrations]
        total = sum(length for length in lengths if length >= window)
        return max(0.0, _MIN_WINDOWS * window - max([total, *lengths]))

    def _requirement(self, demonstrations: Sequence[Demonstration]) -> str:
        """Return what is still to be shown before learning; empty if nothing is missing."""
        window = self._scenario.skill.window
        if not (missing := self._missing(demonstrations)):
            return ""
        requirement = f"show {np.ceil(missing):.0f} s more"
        if len(demonstrations) > 1 and min(d.duration for d in demonstrations) < window:
            requirement += (
                f" without letting go (parts below {window:g} s do not add up)"
            )
        return requirement

    def _teach(self, q: Array | None) -> None:
        if self._run is not None:
            self._run.remove_controls()
        station = MakeStation(self._scenario, self._hand, q=q, meshcat=self._meshcat)
        if self._meshcat is not None:
            self._meshcat.Delete("/force")  # The arrow of the wiping station.
        self._run, self.simulator = None, Simulator(station)
        self._station, self._position = station, "position"
        self._begin()

    def _play(
        self, skill: FourierMovementPrimitive, demonstrations: list[Demonstration]
    ) -> None:
        run = MakeRun(
            self._scenario,
            skill,
            demonstrations=demonstrations,
            q=self._joint_angles(),
            meshcat=self._meshcat,
            panel=self._panel,
        )
        if self._run is not None:
            self._run.remove_controls()
        elif self._meshcat is not None:
            self._meshcat.DeleteSlider(TURN_SWITCH, strict=False)
        self.skill, self._earlier, self._learned = skill, demonstrations, demonstrations
        self._run, self.simulator = run, run.simulator
        self._station, self._position = run.station, "measured_position"
        self._begin()

    def _begin(self) -> None:
        self._clear_samples()
        self.simulator.set_target_realtime_rate(0.0 if self._clock is None else 1.0)
        self.simulator.Initialize()
        # Drake does not leave out the time of the first events, which may compile.
        self.simulator.ResetStatistics()

    def _clear_samples(self) -> None:
        self._samples, self._lag, self._drawn, self._discarded = [], 0.0, 0, []
        if self._meshcat is not None:
            self._meshcat.Delete(f"{BOARD}/taught")
            if self._run is None:
                paths = [d.values[:, :3] for d in self._earlier]
                draw_demonstrations(
                    self._meshcat, f"{BOARD}/taught/kept", paths, surface=self._surface
                )

    # Outputs --------------------------------------------------------------------------

    def _output(self, name: str) -> Array:
        """Return the value of an output port of the station, or of its mouse.

        It is 0 for an output of the mouse where there is none.
        """
        system: Any = self._station
        if name in ("is_guided", "cursor_interval") and not system.HasOutputPort(name):
            if not system.HasSubsystemNamed("mouse_hand"):
                return np.zeros(1)
            system = system.GetSubsystemByName("mouse_hand")
        context = system.GetMyContextFromRoot(self.simulator.get_context())
        return np.array(system.GetOutputPort(name).Eval(context))

    def _joint_angles(self) -> Array:
        state = self._output("state")
        return state[: len(state) // 2]

    def _draw(self) -> None:
        """Draw the samples since the last drawing."""
        samples = self._samples[self._drawn :]
        is_guided = all(s[5] for s in samples)
        if self._meshcat is not None and is_guided and len(samples) > 1:
            self._draw_path(str(self._drawn), np.array([s[2:5] for s in samples]))
        if len(samples) > _CHUNK or not is_guided:
            self._drawn = len(self._samples) - 1

    def _draw_path(self, name: str, points: Array) -> None:
        if self._meshcat is not None:
            path = f"{BOARD}/taught/{name}"
            draw_rod(
                self._meshcat,
                path,
                points,
                radius=0.0025,
                color=TRAIL_COLOR,
                surface=self._surface,
            )

    @property
    def status(self) -> str:
        """Sentence about the state of the session, and what learning still needs."""
        if isinstance(self._run, WipingRun):
            cleaned = cleaned_fraction(self._run.ink(), self._run.demonstrated_area)
            status = f"wiping: {100 * cleaned:.0f} % of the demonstrated area is clean"
        elif self._run is not None:
            status = "following the demonstration"
        elif requirement := self.requirement:
            status = requirement
        else:
            status = "enough to learn; more is better"
        if self.realtime_rate < _SLOW_RATE:
            status += (
                f"; this machine is too slow to teach on "
                f"({100 * self.realtime_rate:.0f} % of real time)"
            )
        return status
