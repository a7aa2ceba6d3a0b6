"""One run of the wiping station, with everything that is measured on it."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.yaml import yaml_dump_typed
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from fmp_drake.errors import FmpError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.runs.log import RunLog, Signal
from fmp_drake.station.parts.page_scene import BOARD, INK
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.wiping_station import MakeWipingStation
from fmp_drake.systems.ink.recording import AddInkToRecording
from fmp_drake.systems.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.viewer.path_drawing import draw_line

STEP = 0.001
"""Seconds between samples of what is state of the diagram, and cheap to log."""

# What is logged in every run, with its period in seconds.
_LOGGED = {
    "torque": STEP,
    "actuation": STEP,
    "state": STEP,
    "status": STEP,
    "desired_position": 0.005,
    "desired_velocity": 0.005,
    "measured_position": 0.005,
    "remaps": 0.005,
    "normal_force": 0.01,
    "cleaned_fraction": 0.05,
    "disturbance": 0.01,
}
# What is added for a complete log.
_COMPLETE = {
    "desired_acceleration": 0.005,
    "measured_velocity": 0.005,
    "tracking_error": 0.005,
    "covariance": 0.05,
    "weights": 0.05,
    "component": 0.05,
    "contact_area": 0.01,
}
_AT_THE_END = ("ink", "erase_time", "fade_time")


class WipingRun:
    """A wiping station with loggers and a simulator.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : sequence of Demonstration
        What it was learned from, in the frame of the board; may be empty.
    start, sample, seed, visuals, meshcat
        As for `MakeWipingStation`.
    recording : bool
        Record the run for `html`.
    complete : bool
        Log every signal, for `run_log`.
    """

    def __init__(
        self,
        scenario: Scenario,
        skill: FourierMovementPrimitive,
        *,
        demonstrations: Sequence[Demonstration] = (),
        start: ArrayLike | None = None,
        sample: bool | None = None,
        seed: int | None = None,
        visuals: str = "own",
        meshcat: Meshcat | None = None,
        recording: bool = False,
        complete: bool = False,
    ) -> None:
        self.scenario = scenario
        self.skill = skill
        self.meshcat = meshcat
        self.seed = scenario.skill.seed if seed is None else seed
        self.demonstrated = [d.values for d in demonstrations] or [
            skill.synthesize(c.mean) for c in skill.components_
        ]
        self.station = MakeWipingStation(
            scenario,
            skill,
            start=start,
            sample=sample,
            seed=self.seed,
            visuals=visuals,
            meshcat=meshcat,
            demonstrated=self.demonstrated if demonstrations else (),
        )
        builder = DiagramBuilder()
        builder.AddSystem(self.station)
        self._sinks = {}
        for name, period in (_LOGGED | (_COMPLETE if complete else {})).items():
            if not self.station.HasOutputPort(name):
                continue
            sink = LogVectorOutput(self.station.GetOutputPort(name), builder, period)
            sink.set_name(f"log_{name}")
            self._sinks[name] = sink
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        if scenario.plant.time_step == 0:
            ApplySimulatorConfig(scenario.simulator, self.simulator)
        ink_board: Any = self.station.GetSubsystemByName("ink_board")
        self.grid = ink_board.grid
        self.initial_ink = ink_board.initial_ink
        self._recording = recording and meshcat is not None
        self.record_again()

    def record_again(self) -> None:
        """Begin the recording, if there is one, anew."""
        if self.meshcat is not None and self._recording:
            self.meshcat.DeleteRecording()
            self.meshcat.StartRecording(frames_per_second=30.0)

    def remove_controls(self) -> None:
        """Take the controls, which act no more after a run, from the page."""
        for name in ("page_controls", "plan_visualizer"):
            if self.station.HasSubsystemNamed(name):
                system: Any = self.station.GetSubsystemByName(name)
                system.Delete()

    @property
    def logged(self) -> tuple[str, ...]:
        """The names of the logged signals."""
        return tuple(self._sinks)

    def log(self, name: str) -> NDArray[np.float64]:
        """Return the logged values of an output port, shape (samples, size)."""
        log: Any = self._sinks[name].FindLog(self.simulator.get_context())
        return np.array(log.data().T)

    def log_times(self, name: str) -> NDArray[np.float64]:
        """Return the times of the logged values, shape (samples,), s."""
        log: Any = self._sinks[name].FindLog(self.simulator.get_context())
        return np.array(log.sample_times())

    def output(self, name: str) -> NDArray[np.float64]:
        """Return what an output port of the station says now."""
        context = self.station.GetMyContextFromRoot(self.simulator.get_context())
        value: Any = self.station.GetOutputPort(name).Eval(context)
        return np.array(value)

    def ink(self) -> NDArray[np.float64]:
        """Return the ink that is left, shape (ny, nx)."""
        return self.output("ink").reshape(self.grid.shape)

    @cached_property
    def _demonstrated_area(self) -> NDArray[np.bool_]:
        x, y = self.scenario.eraser.footprint
        area = np.zeros(self.grid.shape, dtype=bool)
        for path in self.demonstrated:
            area |= self.grid.swept_area(path, (x, y))
        return area

    def demonstrated_area(self) -> NDArray[np.bool_]:
        """Return the cells that the demonstrated eraser passed over, (ny, nx)."""
        return self._demonstrated_area

    def run_log(self, figures: dict[str, Any]) -> RunLog:
        """Return everything that was logged, with the ink at the end."""
        signals = {
            name: Signal.named(name, self.log_times(name), self.log(name))
            for name in self._sinks
        }
        now = self.simulator.get_context().get_time()
        for name in _AT_THE_END:
            signals[name] = Signal.named(name, [now], self.output(name)[None])
        scenario = yaml_dump_typed(self.scenario)  # type: ignore[no-untyped-call]
        return RunLog(
            signals=signals, scenario=scenario, seed=self.seed, figures=figures
        )

    def html(self, duration: float) -> str:
        """Return a page of its own that replays the arm, the force and the ink.

        Call it once, after the run; it needs `recording` and a Meshcat.
        """
        if self.meshcat is None or not self._recording:
            raise FmpError(
                "nothing was recorded; give the run a Meshcat and recording."
            )
        self.meshcat.StopRecording()
        if self.scenario.show.ink:
            AddInkToRecording(
                self.meshcat,
                grid=self.grid,
                initial_ink=self.initial_ink,
                final_ink=self.ink(),
                fade_time=self.output("fade_time"),
                end_time=duration,
                path=INK,
            )
        # What changes its shape cannot be replayed.
        for name in ("plan", "trail"):
            self.meshcat.Delete(f"{BOARD}/{name}")
        if self.scenario.show.trail:
            draw_line(
                self.meshcat,
                f"{BOARD}/measured",
                self.log("measured_position")[::4],
                color=TRAIL_COLOR,
            )
        self.meshcat.PublishRecording()
        return self.meshcat.StaticHtml()
