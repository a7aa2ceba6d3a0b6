"""A session of teaching: show, learn, play, and show again."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import FmpError, RunError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, save_skill
from fmp_drake.primitives.data.recording import hand_time, led_demonstrations
from fmp_drake.runs.skills import learn_skill
from fmp_drake.runs.wiping_run import WipingRun
from fmp_drake.station.feasibility import CheckFeasibility
from fmp_drake.station.parts.hands import TeachingHand
from fmp_drake.station.parts.page_scene import BOARD
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.teaching_station import RATE, MakeTeachingStation
from fmp_drake.systems.ink.grid import cleaned_fraction
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.viewer.page_panel import PagePanel
from fmp_drake.systems.viewer.path_drawing import draw_demonstrations, draw_rod

Mode = Literal["teach", "play"]

BUTTONS: dict[Mode, tuple[str, ...]] = {
    "teach": ("learn", "again", "play", "save"),
    "play": ("teach", "more", "save"),
}
"""What may be pressed."""

# Windows that must have been shown.
_WINDOWS = 2
# A simulation that fell behind by this, s, does not make up for it.
_BEHIND = 0.2
# Below this many simulated seconds per second, over so many seconds, a machine is slow.
_SLOW, _JUDGED = 0.9, 3.0
# Samples that are drawn at once.
_CHUNK = 20


class TeachingSession:
    """The arm is led by a hand, learns from it, and plays what it has learned.

    It does what the buttons say, which a page or a program presses. In the mode `teach`
    a hand leads the arm, and what it shows is recorded; in the mode `play` the arm wipes
    with the learned skill, from where it is, and may be pulled. Nothing jumps between them.

    Buttons: *learn* from what was shown, and play it; *again*: forget what was shown since
    the last learning; *play* the last skill; *teach* anew; *more*: learn also from what was
    shown by pulling the arm while it played or, if it was not, show another demonstration
    that is learned together with the others; *save*.

    Parameters
    ----------
    scenario : Scenario
    hand : TeachingHand
        A `MouseOnPage`, for example.
    panel : PagePanel, optional
        The page where it is shown.
    clock : callable, optional
        Returns the time, s: the simulation keeps pace with it, and what is recorded has its
        rhythm. None to simulate as fast as possible.
    out, skill_file : Path
        Files for *save*: the demonstration (a second and third one get a number) and the
        skill.

    Attributes
    ----------
    mode : {'teach', 'play'}
    skill : FourierMovementPrimitive or None
        What was learned last.
    remark : str
        What came of the last button.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario, SimulatedHand
    >>> from fmp_drake.systems import HandMotion
    >>> hand = SimulatedHand(HandMotion.make("eight", seconds=20.0, seed=0))
    >>> session = TeachingSession(LoadScenario("table_top"), hand, clock=None)
    >>> session.advance(0.2)
    >>> session.press("learn")
    >>> session.mode, session.remark
    ('teach', 'show 12 s more: two windows of 6 s are the least to learn from')
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
        self._out, self._skill_file = out, skill_file
        self.skill: FourierMovementPrimitive | None = None
        self.remark = ""
        self._kept: list[Demonstration] = []
        self._run: WipingRun | None = None
        self._samples: list[tuple[Any, ...]] = []
        self._lag, self._drawn = 0.0, 0
        self._teach(None)

    @property
    def mode(self) -> Mode:
        """What the arm does: `teach` while it is led, `play` while it plays."""
        return "teach" if self._run is None else "play"

    @property
    def buttons(self) -> tuple[str, ...]:
        """What may be pressed now."""
        return BUTTONS[self.mode]

    @property
    def is_led(self) -> bool:
        """Whether somebody leads or pulls the arm now."""
        return bool(self._output("leading")[0])

    @property
    def missing(self) -> float:
        """How many seconds are to be shown before it can learn; 0 if none."""
        return self._missing(self.demonstrations)

    @property
    def simulator(self) -> Simulator:
        """Of the station of this mode."""
        return self._simulator

    @property
    def demonstrations(self) -> list[Demonstration]:
        """All that was shown and not forgotten, in the frame of the board."""
        return [*self._kept, *self._shown()]

    # Time -----------------------------------------------------------------------------

    def advance(self, seconds: float) -> None:
        """Simulate for a time, and record; s."""
        context = self._simulator.get_context()
        end = context.get_time() + seconds
        while (now := context.get_time()) < end - 1e-9:
            sample = (np.floor(now * RATE + 1e-6) + 1) / RATE
            then = float(min(sample, end))
            if self._run is None:
                self._simulator.AdvanceTo(then)
            else:
                self._run.advance_to(then)
            if then > sample - 1e-6 / RATE:
                self._record()

    def _record(self) -> None:
        now = self._simulator.get_context().get_time()
        clock = now if self._clock is None else self._clock()
        position, leads = self._output(self._position), self.is_led
        self._samples.append((now, clock, *position, leads))
        lag = (clock - self._samples[0][1]) - (now - self._samples[0][0])
        if self._clock is not None and lag - self._lag > _BEHIND:
            self._simulator.ResetStatistics()
            self._lag = lag
        if self._run is None:
            self._draw()

    @property
    def realtime_rate(self) -> float:
        """Simulated seconds per second of the clock, over the last 3 s."""
        last = self._samples[-1:]
        since = [s for s in self._samples[-200:] if s[1] > last[0][1] - _JUDGED]
        if len(since) < _CHUNK or since[-1][1] <= since[0][1]:
            return 1.0
        return (since[-1][0] - since[0][0]) / (since[-1][1] - since[0][1])

    # What the buttons do ---------------------------------------------------------------

    def press(self, button: str) -> None:
        """Do what a button says.

        Raises
        ------
        RunError
            Where there is no such button in this mode.
        """
        if button not in self.buttons:
            raise RunError(
                f"there is no button {button!r} in the mode {self.mode}; press one of: "
                f"{', '.join(self.buttons)}."
            )
        self.remark = ""
        try:
            getattr(self, f"_press_{button}")()
        except FmpError as error:
            self.remark = str(error)

    def _press_learn(self) -> None:
        self._learn(self.demonstrations)

    def _press_again(self) -> None:
        self._forget()
        self.remark = "forgotten"

    def _press_play(self) -> None:
        if self.skill is None:
            raise RunError("there is no skill yet: learn first")
        self._play(self.skill, self._kept)

    def _press_teach(self) -> None:
        self._kept = []
        self._teach(self._q())

    def _press_more(self) -> None:
        window = self._scenario.skill.window
        shown = [d for d in self._shown() if d.duration >= window]
        if shown:
            self._learn([*self._kept, *shown])
        else:
            self._teach(self._q())
            self.remark = "show more: it is learned together with the first"

    def _press_save(self) -> None:
        demonstrations = self.demonstrations if self._run is None else self._kept
        written = []
        for i, demonstration in enumerate(demonstrations):
            stem = self._out.stem if i == 0 else f"{self._out.stem}_{i + 1}"
            path = self._out.with_name(stem + self._out.suffix)
            demonstration.save(path)
            written.append(path.name)
        if self.skill is not None:
            save_skill(self.skill, self._skill_file)
            written.append(self._skill_file.name)
        self.remark = (
            f"wrote {', '.join(written)}" if written else "nothing to save yet"
        )

    # Modes ----------------------------------------------------------------------------

    def _learn(self, demonstrations: list[Demonstration]) -> None:
        """Learn from all that was shown, and play it; nothing changes if that fails."""
        window = self._scenario.skill.window
        if (missing := self._missing(demonstrations)) > 0:
            raise RunError(
                f"show {np.ceil(missing):.0f} s more: two windows of {window:g} s are the "
                "least to learn from"
            )
        started = time.perf_counter()
        skill = learn_skill(
            demonstrations,
            window=window,
            components=self._scenario.skill.components,
        )
        self._play(skill, demonstrations)
        self.remark = f"learned in {time.perf_counter() - started:.1f} s"
        found = CheckFeasibility(self._scenario, skill)
        if not found.is_feasible:
            self.remark += f"; {found.verdict}"

    def _missing(self, demonstrations: Sequence[Demonstration]) -> float:
        """Return how many seconds are missing to learn; 0 if none."""
        window = self._scenario.skill.window
        lengths = [d.duration + 1 / RATE for d in demonstrations]
        long = sum(length for length in lengths if length >= window)
        return max(0.0, _WINDOWS * window - max([long, *lengths]))

    def _teach(self, q: NDArray[np.float64] | None) -> None:
        if self._run is not None:
            self._run.remove_controls()
        station = MakeTeachingStation(
            self._scenario, self._hand, q=q, meshcat=self._meshcat
        )
        if self._meshcat is not None:
            self._meshcat.Delete("/force")  # The arrow of the wiping station.
        self._run, self._simulator = None, Simulator(station)
        self._station, self._position = station, "position"
        self._begin()

    def _play(
        self, skill: FourierMovementPrimitive, demonstrations: list[Demonstration]
    ) -> None:
        run = WipingRun(
            self._scenario,
            skill,
            demonstrations=demonstrations,
            q=self._q(),
            meshcat=self._meshcat,
            panel=self._panel,
        )
        if self._run is not None:
            self._run.remove_controls()
        self.skill, self._kept = skill, demonstrations
        self._run, self._simulator = run, run.simulator
        self._station, self._position = run.station, "measured_position"
        self._begin()

    def _begin(self) -> None:
        self._forget()
        self._simulator.set_target_realtime_rate(0.0 if self._clock is None else 1.0)
        self._simulator.Initialize()

    def _forget(self) -> None:
        self._samples, self._lag, self._drawn = [], 0.0, 0
        if self._meshcat is not None:
            self._meshcat.Delete(f"{BOARD}/taught")
            if self._run is None:
                paths = [d.values for d in self._kept]
                draw_demonstrations(self._meshcat, f"{BOARD}/taught/kept", paths)

    # What is seen ----------------------------------------------------------------------

    def _output(self, name: str) -> NDArray[np.float64]:
        """Return what an output port of the station says, or of its mouse."""
        root = self._simulator.get_context()
        station: Any = self._station
        if name == "leading" and not station.HasOutputPort(name):
            if not station.HasSubsystemNamed("mouse_hand"):
                return np.zeros(1)
            station = station.GetSubsystemByName("mouse_hand")
        context = station.GetMyContextFromRoot(root)
        return np.array(station.GetOutputPort(name).Eval(context))

    def _q(self) -> NDArray[np.float64]:
        state = self._output("state")
        return state[: len(state) // 2]

    def _shown(self) -> list[Demonstration]:
        """Return what was shown in this mode since its begin or the last *again*."""
        if not self._samples:
            return []
        samples = np.array(self._samples, dtype=float)
        mouse: Any = self._station
        pause = 0.0
        if mouse.HasSubsystemNamed("mouse_hand"):
            mouse = mouse.GetSubsystemByName("mouse_hand")
            context = mouse.GetMyContextFromRoot(self._simulator.get_context())
            pause = float(mouse.GetOutputPort("cursor_interval").Eval(context)[0])
        return led_demonstrations(
            hand_time(samples[:, 0], samples[:, 1]),
            samples[:, 2:5],
            samples[:, 5],
            rate=RATE,
            frame_seconds=pause,
            note=f"shown by hand: {type(self._hand).__name__}; simulated arm",
        )

    def _draw(self) -> None:
        """Draw what was recorded since the last drawing."""
        part = self._samples[self._drawn :]
        led = [s for s in part if s[5]]
        if self._meshcat is not None and len(led) == len(part) > 1:
            draw_rod(
                self._meshcat,
                f"{BOARD}/taught/{self._drawn}",
                np.array([s[2:5] for s in part]),
                radius=0.0025,
                color=TRAIL_COLOR,
            )
        if len(part) > _CHUNK or len(led) < len(part):
            self._drawn = len(self._samples) - 1

    @property
    def status(self) -> str:
        """What the session does, and what is in the way; a sentence."""
        if self._run is not None:
            cleaned = cleaned_fraction(self._run.ink(), self._run.demonstrated_area)
            said = f"wiping: {100 * cleaned:.0f} % of what was shown is clean"
        elif missing := self.missing:
            said = f"{missing:.0f} s to show, at least"
        else:
            said = "enough to learn; more is better"
        if self.realtime_rate < _SLOW:
            said += (
                f"; this machine is too slow to teach on "
                f"({100 * self.realtime_rate:.0f} % of real time)"
            )
        return said
