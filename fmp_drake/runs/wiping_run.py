"""Run of a station with a board: ink and normal force."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.runs.log import Spill
from fmp_drake.runs.metrics import ink_metrics
from fmp_drake.runs.station_run import StationRun
from fmp_drake.station import Scenario
from fmp_drake.station.page.page_scene import INK
from fmp_drake.systems.erase_times import EraseTimes
from fmp_drake.systems.ink.grid import CLEAN_BELOW, cleaned_history
from fmp_drake.systems.ink.mesh import AddInkToRecording

# Shortest time between two samples of the ink of a recording, s.
_INK_PERIOD = 0.25


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

    _replayed = ("measured_position", "normal_force")
    _title = "A whiteboard is wiped"

    def _add_systems(self, builder: DiagramBuilder) -> None:
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
        self._ink_times = Spill()
        self._ink_samples = Spill((self.grid.num_cells,), np.uint8)
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
        other_metrics = super().metrics()
        return {
            **ink_metrics(
                ink=self.ink(),
                initial_ink=self.initial_ink,
                erase_time=self.erase_time(),
                area=self.demonstrated_area,
                grid=self.grid,
                seconds=self.simulator.get_context().get_time(),
            ),
            **other_metrics,
        }

    def ink(self) -> NDArray[np.float64]:
        """Return the remaining ink, shape (ny, nx)."""
        return self.output("ink").reshape(self.grid.shape)

    def erase_time(self) -> NDArray[np.float64]:
        """Return the time at which each cell became clean, (ny, nx), s; `inf` for none."""
        context = self._erase_times.GetMyContextFromRoot(self.simulator.get_context())
        times: Any = self._erase_times.get_output_port().Eval(context)
        return np.array(times).reshape(self.grid.shape)

    @cached_property
    def demonstrated_area(self) -> NDArray[np.bool_]:
        """Cells below the demonstrated paths of the eraser, shape (ny, nx)."""
        x, y = self.scenario.eraser.footprint
        paths = [path[:, self.roles.position] for path in self.demonstrated]
        return self.grid.swept_by(paths, (x, y))

    def cleaned_by(self, times: ArrayLike) -> NDArray[np.float64]:
        """Return the clean fraction of the demonstrated area with ink at times (N,), s."""
        area = self.demonstrated_area & (self.initial_ink >= CLEAN_BELOW)
        return cleaned_history(self.erase_time(), area, times)

    def _final_signals(self) -> dict[str, NDArray[np.float64]]:
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

    def _replay_series(self) -> dict[str, NDArray[np.float64]]:
        times = self._ink_times.array()
        force = np.interp(
            times, self.log_times("normal_force"), self.log("normal_force")[:, 0]
        )
        return {"time": times, "cleaned": self.cleaned_by(times), "force": force}
