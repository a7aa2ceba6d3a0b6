"""One run of the wiping station, with everything that is measured on it."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from math import floor, isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.yaml import yaml_dump_typed
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from fmp_drake.errors import RunError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.runs.events import RunEvents
from fmp_drake.runs.ink_metrics import ink_metrics
from fmp_drake.runs.log import Rows, write_log
from fmp_drake.runs.metrics import (
    METRIC_SIGNALS,
    ForceMetrics,
    JointLimits,
    LimitMetrics,
    Metrics,
    RegionMetrics,
    Samples,
    TrackingMetrics,
)
from fmp_drake.runs.page_text import describe_page
from fmp_drake.runs.run_event import RunEvent
from fmp_drake.runs.signals import SIGNALS, signal_kind
from fmp_drake.runs.spill import Spill
from fmp_drake.station.parts.page_scene import BOARD, INK
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.wiping_station import MakeWipingStation
from fmp_drake.systems.erase_times import EraseTimes
from fmp_drake.systems.ink.grid import CLEAN_BELOW
from fmp_drake.systems.ink.metrics import cleaned_history
from fmp_drake.systems.ink.recording import AddInkToRecording
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.viewer.page_panel import PagePanel, add_panel
from fmp_drake.systems.viewer.path_recording import AddPathToRecording

# Simulated seconds after which the logged samples are taken in, at the latest.
_CHUNK = 1.0
# Of a recording: seconds between two looks at the ink, at the least, and points of the
# path at the most.
_INK_PERIOD = 0.25
_PATH_POINTS = 20_000


class WipingRun:
    """A wiping station with loggers and a simulator.

    What is logged is taken in while the run goes: into the metrics, and into temporary
    files as far as it is to be kept. Memory does not grow with the run.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : sequence of Demonstration
        What it was learned from, in the frame of the board; may be empty.
    start, q, sample, seed, visuals, meshcat, panel
        As for `MakeWipingStation`.
    recording : bool
        Record the run for `html`.
    keep : iterable of str
        Signals to keep for `log` and `save_log`, by names of `SIGNALS`; those that the
        scenario does not have are left out.

    Attributes
    ----------
    station : Diagram
    diagram : Diagram
        The station with its loggers: the simulator's system.
    simulator : Simulator
    grid : InkGrid
        The cells of the ink.
    initial_ink : ndarray, shape (ny, nx)
        From 0 to 1.
    kept : set of str
        The signals that are kept.
    demonstrated : list of ndarray, shape (N, 3)
        The demonstrated paths in B, or those of the skill's components, m.

    Examples
    --------
    >>> from fmp_drake.runs import scenario_skill
    >>> from fmp_drake.station import LoadScenario
    >>> scenario = LoadScenario("table_top")
    >>> skill, demonstrations, _ = scenario_skill(scenario)
    >>> run = WipingRun(scenario, skill, demonstrations=demonstrations)
    >>> run.advance_to(0.2)
    >>> run.metrics()["remap_count"]
    0
    """

    def __init__(
        self,
        scenario: Scenario,
        skill: FourierMovementPrimitive,
        *,
        demonstrations: Sequence[Demonstration] = (),
        start: ArrayLike | None = None,
        q: ArrayLike | None = None,
        sample: bool | None = None,
        seed: int | None = None,
        visuals: str = "own",
        meshcat: Meshcat | None = None,
        panel: PagePanel | None = None,
        recording: bool = False,
        keep: Iterable[str] = (),
    ) -> None:
        self.scenario = scenario
        self.skill = skill
        self.meshcat = meshcat
        self.seed = scenario.skill.seed if seed is None else seed
        if panel is not None:
            panel.show(**describe_page(scenario))
        paths = [d.values for d in demonstrations] or list(skill.paths_)
        self.demonstrated = paths or [
            skill.synthesize(c.mean) for c in skill.components_
        ]
        self.station = MakeWipingStation(
            scenario,
            skill,
            start=start,
            q=q,
            sample=sample,
            seed=self.seed,
            visuals=visuals,
            meshcat=meshcat,
            panel=panel,
            demonstrated=paths,
        )
        primitive: Any = self.station.GetSubsystemByName("fourier_primitive")
        self._region = primitive.player.region
        ink_board: Any = self.station.GetSubsystemByName("ink_board")
        self.grid = ink_board.grid
        self.initial_ink = ink_board.initial_ink
        builder = DiagramBuilder()
        builder.AddSystem(self.station)
        self._erase_times = builder.AddSystem(
            EraseTimes(initial_ink=self.initial_ink, period=scenario.ink.period)
        )
        builder.Connect(
            self.station.GetOutputPort("ink"), self._erase_times.GetInputPort("ink")
        )
        self._recording = recording and meshcat is not None
        replayed = ("measured_position", "normal_force") if self._recording else ()
        self.kept = {
            name
            for name in {*keep, *replayed}
            if isfinite(signal_kind(name).period) and self.station.HasOutputPort(name)
        }
        self._sinks: dict[str, VectorLogSink] = {}
        for name in sorted({*METRIC_SIGNALS, *self.kept}):
            port = self.station.GetOutputPort(name)
            sink = LogVectorOutput(port, builder, signal_kind(name).period)
            sink.set_name(f"log_{name}")
            self._sinks[name] = sink
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        if scenario.plant.time_step == 0:
            ApplySimulatorConfig(scenario.simulator, self.simulator)
        self.begin_again()

    def begin_again(self) -> None:
        """Forget what was taken in, for a simulation that was reset; record anew."""
        limits = LimitMetrics(self._joint_limits())
        press = self.scenario.press
        force = ForceMetrics(press.force)
        tracking = TrackingMetrics(press.engage_height)
        region = RegionMetrics(self._region)
        self._metrics = (force, tracking, region, limits)
        self._events = RunEvents()
        self._outside = region.outside
        self._values = {
            name: Spill((self.station.GetOutputPort(name).size(),))
            for name in self.kept
        }
        self._times = {signal_kind(name).period: Spill() for name in self.kept}
        self._looks = Spill()
        self._inks = Spill((self.grid.num_cells,), np.uint8)
        if self.meshcat is not None and self._recording:
            self._look()
            self.meshcat.DeleteRecording()
            self.meshcat.StartRecording(frames_per_second=30.0)

    def remove_controls(self) -> None:
        """Take the controls, which act no more after a run, from the page."""
        if self.station.HasSubsystemNamed("page_controls"):
            controls: Any = self.station.GetSubsystemByName("page_controls")
            controls.Delete()

    def advance_to(self, time: float) -> None:
        """Advance the simulation to a time, s, and take in what is logged."""
        while (now := self.simulator.get_context().get_time()) < time:
            chunk_end = (floor(now / _CHUNK) + 1) * _CHUNK
            self.simulator.AdvanceTo(min(chunk_end, time))
            self._take_in()

    def _take_in(self) -> None:
        """Move what was logged since the last time into metrics and kept signals."""
        context = self.simulator.get_mutable_context()
        chunk = {}
        for name, sink in self._sinks.items():
            log = sink.FindMutableLog(context)
            chunk[name] = Samples(log.sample_times().copy(), log.data().T.copy())
            log.Clear()
        for metrics in self._metrics:
            metrics.update(chunk)
        self._events.update(chunk)
        times = {}
        for name, spill in self._values.items():
            times[signal_kind(name).period], values = chunk[name]
            spill.append(values)
        for period, added in times.items():
            self._times[period].append(added)
        if self._recording and context.get_time() >= self._looked + _INK_PERIOD:
            self._look()

    def _look(self) -> None:
        """Keep the ink for the recording."""
        self._looked = self.simulator.get_context().get_time()
        self._looks.append(self._looked)
        self._inks.append(np.rint(255 * np.clip(self.output("ink"), 0, 1)))

    def log(self, name: str) -> NDArray[np.float64]:
        """Return the values of a kept signal, shape (samples, size), read only."""
        self._take_in()
        try:
            return self._values[name].array()
        except KeyError:
            raise RunError(
                f"the signal {name} was not kept; the run keeps "
                f"{', '.join(sorted(self.kept)) or 'none'}."
            ) from None

    def log_times(self, name: str) -> NDArray[np.float64]:
        """Return the times of the values of a kept signal, shape (samples,), s."""
        self.log(name)  # Refuses a signal that was not kept.
        return self._times[signal_kind(name).period].array()

    def metrics(self) -> Metrics:
        """Return the metrics of the run so far; what was never reached is None."""
        self._take_in()
        remaps, reactive = self.output("remaps")
        return {
            **ink_metrics(
                ink=self.ink(),
                initial_ink=self.initial_ink,
                erase_time=self.erase_time(),
                area=self.demonstrated_area,
                grid=self.grid,
                seconds=self.simulator.get_context().get_time(),
            ),
            **{k: v for each in self._metrics for k, v in each.result().items()},
            "remap_count": int(remaps),
            "reactive_remap_count": int(reactive),
        }

    def events(self) -> list[RunEvent]:
        """Return what went wrong in the run so far, in the order of time."""
        self._take_in()
        return sorted([*self._events.result(), *self._outside.events()])

    def _joint_limits(self) -> JointLimits:
        plant: Any = self.station.GetSubsystemByName("plant")
        n = plant.num_positions(plant.GetModelInstanceByName("panda"))
        return JointLimits(
            lower=plant.GetPositionLowerLimits()[:n],
            upper=plant.GetPositionUpperLimits()[:n],
            speed=plant.GetVelocityUpperLimits()[:n],
            torque=plant.GetEffortUpperLimits()[:n],
        )

    def output(self, name: str) -> NDArray[np.float64]:
        """Return what an output port of the station says now."""
        context = self.station.GetMyContextFromRoot(self.simulator.get_context())
        value: Any = self.station.GetOutputPort(name).Eval(context)
        return np.array(value)

    def ink(self) -> NDArray[np.float64]:
        """Return the ink that is left, shape (ny, nx)."""
        return self.output("ink").reshape(self.grid.shape)

    def erase_time(self) -> NDArray[np.float64]:
        """Return when each cell became clean, shape (ny, nx), s; `inf` where it is not."""
        context = self._erase_times.GetMyContextFromRoot(self.simulator.get_context())
        times: Any = self._erase_times.get_output_port().Eval(context)
        return np.array(times).reshape(self.grid.shape)

    @cached_property
    def demonstrated_area(self) -> NDArray[np.bool_]:
        """The cells that the demonstrated eraser passed over, shape (ny, nx)."""
        x, y = self.scenario.eraser.footprint
        return self.grid.swept_by(self.demonstrated, (x, y))

    def cleaned_by(self, times: ArrayLike) -> NDArray[np.float64]:
        """Return the fraction of the inked demonstrated area that was clean by times (N,), s."""
        area = self.demonstrated_area & (self.initial_ink >= CLEAN_BELOW)
        return cleaned_history(self.erase_time(), area, times)

    def save_log(self, path: Path, metrics: Mapping[str, Any]) -> None:
        """Write the kept signals, and the ink at the end, to a file for `RunLog.load`.

        Raises
        ------
        RunError
            Where it cannot be written; an existing file is then as before.
        """
        self._take_in()
        signals: dict[str, tuple[Rows, Rows]] = {
            name: (self._times[kind.period], self._values[name])
            for name, kind in SIGNALS.items()
            if name in self.kept
        }
        now = np.array([self.simulator.get_context().get_time()])
        for name, cells in (("ink", self.ink()), ("erase_time", self.erase_time())):
            signals[name] = (now, cells.reshape(1, -1))
        scenario = yaml_dump_typed(self.scenario)  # type: ignore[no-untyped-call]
        write_log(path, signals, scenario=scenario, seed=self.seed, metrics=metrics)

    def html(self, *, title: str = "A whiteboard is wiped") -> str:
        """Return a page of its own that replays the arm, the force and the ink.

        Call it once, after the run; it needs `recording` and a Meshcat. The title is
        shown in the tab and above the legend.
        """
        if self.meshcat is None or not self._recording:
            raise RunError(
                "nothing was recorded; give the run a Meshcat and recording."
            )
        self.meshcat.StopRecording()
        self._look()
        if self.scenario.show.ink:
            AddInkToRecording(
                self.meshcat,
                grid=self.grid,
                times=self._looks.array(),
                ink=self._inks.array(),
                path=INK,
            )
        # What changes its shape cannot be replayed.
        for name in ("plan", "trail"):
            self.meshcat.Delete(f"{BOARD}/{name}")
        if self.scenario.show.trail:
            path = self.log("measured_position")
            shown = np.s_[:: max(4, -(-len(path) // _PATH_POINTS))]
            AddPathToRecording(
                self.meshcat,
                f"{BOARD}/measured",
                times=self.log_times("measured_position")[shown],
                points=path[shown],
                color=TRAIL_COLOR,
            )
        self.meshcat.PublishRecording()
        text = describe_page(self.scenario, replay=True)
        text["title"] = title
        seconds = self.simulator.get_context().get_time()
        text["mode"], text["detail"] = "replay", f"of a run of {seconds:g} s"
        times = self._looks.array()
        force = np.interp(
            times, self.log_times("normal_force"), self.log("normal_force")[:, 0]
        )
        told = {"time": times, "cleaned": self.cleaned_by(times), "force": force}
        text["replay"] = {k: np.round(v, 3).tolist() for k, v in told.items()}
        return add_panel(self.meshcat.StaticHtml(), text)
