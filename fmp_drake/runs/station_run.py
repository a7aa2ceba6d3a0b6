"""Run of a station with its metrics, events and log, with or without a board."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from math import floor, isfinite
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.yaml import yaml_dump_typed
from pydrake.geometry import Meshcat, MeshcatAnimation
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from fmp_drake.errors import RunError
from fmp_drake.numeric import Array, Mask, check_number
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.windows import demonstration_list
from fmp_drake.primitives.model.trajectory_mixture import check_skill
from fmp_drake.runs.events import RunEvent
from fmp_drake.runs.log import (
    SIGNALS,
    Chunk,
    TemporaryArray,
    pop_samples,
    signal_kind,
    skill_signals,
    write_log,
)
from fmp_drake.runs.metrics import RunMetrics, ink_metrics, metric_signals
from fmp_drake.station import MakeStation, Scenario
from fmp_drake.station.page import BOARD, INK, describe_page
from fmp_drake.station.scenario import check_scenario
from fmp_drake.station.skill_motion import ContactHeight, DemonstratedArea, SkillRoles
from fmp_drake.systems import AddPathToRecording, PagePanel
from fmp_drake.systems.erase_times import EraseTimes
from fmp_drake.systems.ink.grid import CLEAN_BELOW, cleaned_history
from fmp_drake.systems.ink.mesh import AddInkToRecording
from fmp_drake.systems.page.page_panel import add_panel
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR

# Longest simulated time for which Drake's log sinks store samples, s.
_CHUNK = 1.0
# Largest number of points of the path in a recording.
_PATH_POINTS = 20_000
# Shortest time between two samples of the ink of a recording, s.
_INK_PERIOD = 0.25


class StationRun:
    """Station that plays a skill, with loggers and a simulator.

    It follows a motion in free space; `WipingRun` also wipes a board. Logged samples are
    collected during the run: they update the metrics, and those of kept signals are stored
    in temporary files. The memory does not grow with the run.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : sequence of Demonstration
        Recordings that the skill was learned from, in the frame of the board; may be
        empty.
    seed, meshcat, panel
        As for `MakeStation`.
    recording : bool
        Record the run for `html`.
    keep : iterable of str
        Names in `SIGNALS` of the signals to keep for `log` and `save_log`; names that the
        station does not have are ignored.
    **station
        Further options of `MakeStation`, such as driver, start, q and sample.

    Attributes
    ----------
    station : Diagram
    diagram : Diagram
        System of the simulator: the station with its loggers.
    simulator : Simulator
    roles : ChannelRoles
        Of the skill.
    kept : set of str
        Names of the kept signals.
    demonstrated : list of ndarray, shape (N, D)
        The demonstrated paths in B, or those of the skill's components.
    wall_seconds : float
        Time that the simulation has taken since its start, s.

    Examples
    --------
    >>> from fmp_drake.skills import scenario_skill
    >>> from fmp_drake.station import LoadScenario
    >>> scenario = LoadScenario("table_top")
    >>> scenario.board.shape = "none"
    >>> skill, demonstrations, _ = scenario_skill(scenario)
    >>> run = StationRun(scenario, skill, demonstrations=demonstrations)
    >>> run.advance_to(0.2)
    >>> "normal_force_mean_n" in run.metrics()
    False
    """

    _replayed: tuple[str, ...] = ("measured_position",)
    _title = "A motion is followed"

    def __init__(
        self,
        scenario: Scenario,
        skill: FourierMovementPrimitive,
        *,
        demonstrations: Sequence[Demonstration] = (),
        seed: int | None = None,
        meshcat: Meshcat | None = None,
        panel: PagePanel | None = None,
        recording: bool = False,
        keep: Iterable[str] = (),
        **station: Any,
    ) -> None:
        if isinstance(keep, str):
            raise RunError(
                f"keep is {keep!r}; give a list of signals, as in [{keep!r}]."
            )
        check_scenario(scenario, "MakeRun(scenario, skill)")
        check_skill(skill, "MakeRun(scenario, skill)")
        self.scenario = scenario
        self.skill = skill
        self.meshcat, self.panel = meshcat, panel
        self.seed = scenario.skill.seed if seed is None else seed
        if panel is not None:
            panel.show(**describe_page(scenario))
        shown = demonstration_list(demonstrations, "MakeRun(..., demonstrations=)")
        paths = [d.values for d in shown] or list(skill.paths_)
        self.demonstrated = paths or [
            skill.synthesize(c.mean) for c in skill.components_
        ]
        self.station = MakeStation(
            scenario,
            skill,
            seed=self.seed,
            meshcat=meshcat,
            panel=panel,
            demonstrated=paths,
            **station,
        )
        self.roles = SkillRoles(skill)
        self._primitive: Any = self.station.GetSubsystemByName("fourier_primitive")
        self._sinks: dict[str, VectorLogSink] = {}
        builder = DiagramBuilder()
        builder.AddSystem(self.station)
        self._add_systems(builder)
        self._recording = recording and meshcat is not None
        self.kept = {
            name
            for name in {*keep, *(self._replayed if self._recording else ())}
            if isfinite(signal_kind(name).period) and self._has(name)
        }
        if self.roles.rotation is None:  # Equivalent to the measured position.
            self.kept.discard("measured_pose")
        metric_names = filter(self._has, metric_signals(self.roles))
        for name in sorted({*metric_names, *self.kept}):
            self._add_sink(builder, name, signal_kind(name).period)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        if scenario.plant.time_step == 0 and station.get("driver") is None:
            ApplySimulatorConfig(scenario.simulator, self.simulator)
        self.restart()

    def _add_systems(self, builder: DiagramBuilder) -> None:
        """Add systems that observe the task."""

    def _has(self, name: str) -> bool:
        return self.station.HasOutputPort(self._port_name(name))

    def _port_name(self, signal: str) -> str:
        """Return the name of the station's output port with a signal."""
        return signal

    def _add_sink(self, builder: DiagramBuilder, name: str, period: float) -> None:
        port = self.station.GetOutputPort(self._port_name(name))
        self._sinks[name] = LogVectorOutput(port, builder, period)
        self._sinks[name].set_name(f"log_{name}")

    def restart(self) -> None:
        """Discard all samples after a reset of the simulation; restart the recording."""
        controller: Any = self.station.GetSubsystemByName("controller")
        update = controller.GetUniquePeriodicDiscreteUpdateAttribute()
        self.wall_seconds = 0.0
        self._metrics = RunMetrics(
            self.scenario,
            self._primitive.player.region,
            controller.limits,
            control_period=update.period_sec(),
            contact_height=ContactHeight(self.scenario, self._primitive.player.skill),
            roles=self.roles,
        )
        self._values = {
            name: TemporaryArray((self._sinks[name].get_input_port().size(),))
            for name in self.kept
        }
        self._times = {signal_kind(name).period: TemporaryArray() for name in self.kept}
        if self.meshcat is not None and self._recording:
            self.meshcat.DeleteRecording()
            self.meshcat.StartRecording(frames_per_second=30.0)

    def remove_controls(self) -> None:
        """Remove the sliders from the page: they have no effect after a run."""
        if self.station.HasSubsystemNamed("page_controls"):
            controls: Any = self.station.GetSubsystemByName("page_controls")
            controls.Delete()

    def show_status(self) -> None:
        """Show the status of now on the page: its panel is otherwise up to 0.13 s old."""
        if self.station.HasSubsystemNamed("page_status"):
            status = self.station.GetSubsystemByName("page_status")
            root = self.simulator.get_context()
            status.ForcedPublish(status.GetMyContextFromRoot(root))

    def advance_to(self, time: float) -> None:
        """Advance the simulation to a time, s, and collect the logged samples."""
        check_number(time, "time", least=0, unit="s", error=RunError)
        begin = perf_counter()
        while (now := self.simulator.get_context().get_time()) < time:
            chunk_end = (floor(now / _CHUNK) + 1) * _CHUNK
            self.simulator.AdvanceTo(min(chunk_end, time))
            self._collect()
        self.wall_seconds += perf_counter() - begin

    def _collect(self) -> None:
        """Move samples from the log sinks into metrics and kept signals."""
        context = self.simulator.get_mutable_context()
        chunk = pop_samples(self._sinks, context)
        self._update(chunk)
        times_by_period = {}
        for name, kept in self._values.items():
            times_by_period[signal_kind(name).period], values = chunk[name]
            kept.append(values)
        for period, times in times_by_period.items():
            self._times[period].append(times)

    def _update(self, chunk: Chunk) -> None:
        """Add samples to the metrics and events."""
        self._metrics.update(chunk)

    def log(self, name: str) -> Array:
        """Return the values of a kept signal, shape (samples, size), read only."""
        self._collect()
        try:
            return self._values[name].array()
        except KeyError:
            raise RunError(
                f"the signal {name} was not kept; the run keeps "
                f"{', '.join(sorted(self.kept)) or 'none'}."
            ) from None

    def log_times(self, name: str) -> Array:
        """Return the times of the values of a kept signal, shape (samples,), s."""
        self.log(name)  # Raises an error for a signal that was not kept.
        return self._times[signal_kind(name).period].array()

    def metrics(self) -> dict[str, Any]:
        """Return the metrics of the run so far; a value that was not reached is None."""
        self._collect()
        remaps, reactive = self.output("remaps")
        return {
            **self._metrics.result(),
            "remap_count": int(remaps),
            "reactive_remap_count": int(reactive),
        }

    def events(self) -> list[RunEvent]:
        """Return the events of the run so far, in chronological order."""
        self._collect()
        return self._metrics.events()

    def recent_events(self) -> list[RunEvent]:
        """Return the events up to the last whole second, without new samples."""
        return self._metrics.events()

    def output(self, name: str) -> Array:
        """Return the current value of an output port of the station."""
        context = self.station.GetMyContextFromRoot(self.simulator.get_context())
        value: Any = self.station.GetOutputPort(name).Eval(context)
        return np.array(value)

    def save_log(self, path: str | Path, metrics: Mapping[str, Any]) -> None:
        """Write the kept signals to a file for `RunLog.load`.

        Raises
        ------
        RunError
            If it cannot be written; an existing file then remains unchanged.
        """
        self._collect()
        skill = self.skill
        times = {period: kept.array() for period, kept in self._times.items()}
        signals = {
            name: (times[kind.period], self._values[name].array())
            for name, kind in SIGNALS.items()
            if name in self.kept
        }
        now = np.array([self.simulator.get_context().get_time()])
        for name, cells in self._final_signals().items():
            signals[name] = (now, cells.reshape(1, -1))
        write_log(
            Path(path),
            signals,
            scenario=yaml_dump_typed(self.scenario),  # type: ignore[no-untyped-call]
            seed=self.seed,
            metrics=metrics,
            kinds=skill_signals(
                skill.channels_,
                skill.units_,
                weights=self._primitive.GetOutputPort("weights").size()
                // skill.n_channels_,
                is_curved=not self.scenario.board.curvature().is_plane,
            ),
        )

    def _final_signals(self) -> dict[str, Array]:
        """Return the signals of a log that are available only at the end of the run."""
        return {}

    def html(self, *, title: str | None = None) -> str:
        """Return a stand-alone page that replays the arm, the force and the ink.

        Call it once, after the run; it needs `recording` and a Meshcat. The title appears
        in the tab and above the legend.
        """
        meshcat = self.meshcat
        if meshcat is None or not self._recording:
            raise RunError(
                "nothing was recorded; give the run a Meshcat and recording."
            )
        meshcat.StopRecording()
        self._finish_recording(meshcat)
        # Meshcat records only transforms: objects with a changing shape cannot be replayed.
        for name in ("plan", "trail"):
            meshcat.Delete(f"{BOARD}/{name}")
        if self.scenario.show.trail:
            path = self.log("measured_position")
            rows = np.s_[:: max(4, -(-len(path) // _PATH_POINTS))]
            AddPathToRecording(
                meshcat,
                f"{BOARD}/measured",
                times=self.log_times("measured_position")[rows],
                points=path[rows],
                color=TRAIL_COLOR,
                surface=self.scenario.board.curvature(),
            )
        meshcat.PublishRecording()
        text = describe_page(self.scenario, replay=True)
        text["title"] = title or self._title
        seconds = self.simulator.get_context().get_time()
        text["mode"], text["detail"] = "replay", f"of a run of {seconds:g} s"
        series = self._replay_series()
        text["replay"] = {k: np.round(v, 3).tolist() for k, v in series.items()}
        page = add_panel(meshcat.StaticHtml(), text)
        self._show_end(meshcat)
        return page

    def _show_end(self, meshcat: Meshcat) -> None:
        """Show the end of the run on its own page, without the recording."""
        meshcat.SetAnimation(MeshcatAnimation())
        meshcat.Delete(f"{BOARD}/measured")
        root = self.simulator.get_context()
        for system in self.station.GetSystems():
            if system.get_name().endswith("_visualizer"):
                system.ForcedPublish(system.GetMyContextFromRoot(root))

    def _finish_recording(self, meshcat: Meshcat) -> None:
        """Add to a recording the drawings that Meshcat does not record."""

    def _replay_series(self) -> dict[str, Array]:
        """Return the time, s, and the other numbers of the panel over time."""
        return {"time": self.log_times("measured_position")[::20]}


def MakeRun(
    scenario: Scenario, skill: FourierMovementPrimitive, **options: Any
) -> StationRun:
    """Return a `WipingRun`, or a `StationRun` where the scenario has no board.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.
    **options
        As for `StationRun`.
    """
    check_scenario(scenario, "MakeRun(scenario, skill)")
    kind = WipingRun if scenario.has_board else StationRun
    return kind(scenario, skill, **options)


class WipingRun(StationRun):
    """Run of a station with a board, its ink and the normal force on it.

    Parameters
    ----------
    scenario, skill, **options
        As for `StationRun`. The scenario has a board.

    Attributes
    ----------
    grid : InkGrid
        Cells of the ink.
    initial_ink : ndarray, shape (ny, nx)
        From 0 to 1.

    Examples
    --------
    >>> from fmp_drake.skills import scenario_skill
    >>> from fmp_drake.station import LoadScenario
    >>> scenario = LoadScenario("table_top")
    >>> skill, demonstrations, _ = scenario_skill(scenario)
    >>> run = WipingRun(scenario, skill, demonstrations=demonstrations)
    >>> run.advance_to(0.2)
    >>> run.metrics()["remap_count"]
    0
    """

    _replayed = ("measured_position", "normal_force", "desired_normal_force")
    _title = "A whiteboard is wiped"

    def _add_systems(self, builder: DiagramBuilder) -> None:
        if not self.scenario.has_board:
            raise RunError(
                "the scenario has no board to wipe; MakeRun(scenario, skill) returns its run."
            )
        ink_board: Any = self.station.GetSubsystemByName("ink_board")
        self.grid = ink_board.grid
        self.initial_ink = ink_board.initial_ink
        self._erase_times = builder.AddSystem(
            EraseTimes(initial_ink=self.initial_ink, period=self.scenario.ink.period)
        )
        builder.Connect(
            self.station.GetOutputPort("ink"), self._erase_times.GetInputPort("ink")
        )

    def restart(self) -> None:
        """Discard all samples after a reset of the simulation; restart the recording."""
        self._ink_times = TemporaryArray()
        self._ink_samples = TemporaryArray((self.grid.num_cells,), np.uint8)
        if self._recording:
            self._record_ink()
        super().restart()

    def _collect(self) -> None:
        super()._collect()
        now = self.simulator.get_context().get_time()
        if self._recording and now >= self._last_ink_time + _INK_PERIOD:
            self._record_ink()

    def _record_ink(self) -> None:
        """Add a sample of the ink to the recording."""
        self._last_ink_time = self.simulator.get_context().get_time()
        self._ink_times.append(self._last_ink_time)
        self._ink_samples.append(np.rint(255 * np.clip(self.output("ink"), 0, 1)))

    def metrics(self) -> dict[str, Any]:
        """Return the metrics of the run so far; a value that was not reached is None."""
        return {
            **ink_metrics(
                ink=self.ink(),
                initial_ink=self.initial_ink,
                erase_time=self.erase_time(),
                area=self.demonstrated_area,
                grid=self.grid,
                seconds=self.simulator.get_context().get_time(),
            ),
            **super().metrics(),
        }

    def ink(self) -> Array:
        """Return the remaining ink, shape (ny, nx)."""
        return self.output("ink").reshape(self.grid.shape)

    def erase_time(self) -> Array:
        """Return the time at which each cell became clean, (ny, nx), s; `inf` for none."""
        context = self._erase_times.GetMyContextFromRoot(self.simulator.get_context())
        times: Any = self._erase_times.get_output_port().Eval(context)
        return np.array(times).reshape(self.grid.shape)

    @cached_property
    def demonstrated_area(self) -> Mask:
        """Cells below the demonstrated paths of the eraser, shape (ny, nx)."""
        return DemonstratedArea(self.scenario, self.skill)

    def cleaned_by(self, times: ArrayLike) -> Array:
        """Return the clean fraction of the demonstrated area with ink at times (N,), s."""
        area = self.demonstrated_area & (self.initial_ink >= CLEAN_BELOW)
        return cleaned_history(self.erase_time(), area, times)

    def desired_force(self) -> Array:
        """Return the desired normal force at the times of `normal_force`, N, shape (N,)."""
        return self.log("desired_normal_force")[:, 0]

    def _final_signals(self) -> dict[str, Array]:
        return {"ink": self.ink(), "erase_time": self.erase_time()}

    def _finish_recording(self, meshcat: Meshcat) -> None:
        self._record_ink()
        if self.scenario.show.ink:
            AddInkToRecording(
                meshcat,
                grid=self.grid,
                times=self._ink_times.array(),
                ink=self._ink_samples.array(),
                path=INK,
            )

    def _replay_series(self) -> dict[str, Array]:
        times = self._ink_times.array()
        series, cleaned = {"time": times}, self.cleaned_by(times)
        if cleaned[0] < 1:  # Otherwise the demonstrated paths touch no ink.
            series["cleaned"] = cleaned
        for key, name in (
            ("force", "normal_force"),
            ("desired_force", "desired_normal_force"),
        ):
            series[key] = np.interp(times, self.log_times(name), self.log(name)[:, 0])
        return series
