"""One run of the wiping station, with everything that is measured on it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from fmp_drake.errors import FmpError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.wiping_station import ERASER_FOOTPRINT, MakeWipingStation
from fmp_drake.systems.ink_grid import cleaned_fraction
from fmp_drake.systems.ink_visualizer import AddInkToRecording
from fmp_drake.systems.path_visualizer import draw_path

# What is logged, with its period in seconds.
_FAST = 0.001
_SLOW = 0.01
_LOGGED = {
    "desired_position": _FAST,
    "desired_velocity": _FAST,
    "measured_position": _FAST,
    "torque": _FAST,
    "actuation": _FAST,
    "state": _FAST,
    "normal_force": _SLOW,
    "cleaned_fraction": _SLOW,
}
_CONTACT_FORCE = 0.5


class WipingRun:
    """A wiping station with loggers, and the figures that come out of a run.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.
    demonstrations : sequence of Demonstration
        What it was learned from, in the frame of the board; may be empty.
    start, sample, seed, meshcat
        As for `MakeWipingStation`.
    recording : bool
        Record the run for `html`.
    """

    def __init__(
        self,
        scenario: Scenario,
        skill: FourierMovementPrimitive,
        *,
        demonstrations: Sequence[Demonstration] = (),
        start: ArrayLike | None = None,
        sample: bool = False,
        seed: int = 0,
        meshcat: Meshcat | None = None,
        recording: bool = False,
    ) -> None:
        self.skill = skill
        self.meshcat = meshcat
        self.X_WB = scenario.board.pose()
        self.station = MakeWipingStation(
            scenario,
            skill,
            start=start,
            sample=sample,
            seed=seed,
            meshcat=meshcat,
        )
        builder = DiagramBuilder()
        builder.AddSystem(self.station)
        self._sinks = {}
        for name, period in _LOGGED.items():
            sink = LogVectorOutput(self.station.GetOutputPort(name), builder, period)
            sink.set_name(f"log_{name}")
            self._sinks[name] = sink
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        ink_board: Any = self.station.GetSubsystemByName("ink_board")
        self.grid = ink_board.grid
        self.initial_ink = ink_board.initial_ink
        self.demonstrated = [d.values for d in demonstrations] or [
            skill.synthesize(c.mean) for c in skill.components_
        ]
        self._recording = recording and meshcat is not None
        if meshcat is not None and self._recording:
            meshcat.StartRecording(frames_per_second=30.0)

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

    def demonstrated_area(self) -> NDArray[np.bool_]:
        """Return the cells that the demonstrated eraser passed over, (ny, nx)."""
        area = np.zeros(self.grid.shape, dtype=bool)
        for path in self.demonstrated:
            area |= self.grid.swept_area(path, ERASER_FOOTPRINT)
        return area

    def figures(self) -> dict[str, float | int]:
        """Return the figures of the report, from the logs of the run."""
        plant: Any = self.station.GetSubsystemByName("plant")
        panda = plant.GetModelInstanceByName("panda")
        n = plant.num_positions(panda)
        lower = plant.GetPositionLowerLimits()[:n]
        upper = plant.GetPositionUpperLimits()[:n]
        speed_limit = plant.GetVelocityUpperLimits()[:n]
        effort = plant.GetEffortUpperLimits()[:n]

        ink = self.ink()
        force = self.log("normal_force")[:, 0]
        touching = force > _CONTACT_FORCE
        since = force[np.argmax(touching) :] if np.any(touching) else force[:0]
        pressed = since[since > _CONTACT_FORCE]
        percentiles = np.percentile(pressed, [5, 95]) if len(pressed) else [0.0, 0.0]
        desired = self.log("desired_position")
        error = np.linalg.norm(desired - self.log("measured_position"), axis=1)
        state = self.log("state")
        q = state[:, :n]
        remaps, jump = self._remaps(desired)
        torque_rate = np.abs(np.diff(self.log("torque"), axis=0)) / _FAST
        return {
            "cleaned_fraction": cleaned_fraction(ink),
            "cleaned_fraction_of_demonstrated_area": cleaned_fraction(
                ink, self.demonstrated_area()
            ),
            "normal_force_mean_n": float(np.mean(pressed)) if len(pressed) else 0.0,
            "normal_force_p05_n": float(percentiles[0]),
            "normal_force_p95_n": float(percentiles[1]),
            "contact_fraction": float(np.mean(since > _CONTACT_FORCE))
            if len(since)
            else 0.0,
            "tracking_rms_m": float(np.sqrt(np.mean(error**2))),
            "remap_count": remaps,
            "remap_position_jump_max_m": jump,
            "torque_ratio_max": float(np.max(np.abs(self.log("actuation")) / effort)),
            "torque_rate_max_nm_per_s": float(np.max(torque_rate, initial=0.0)),
            "joint_limit_margin_min_rad": float(
                min(np.min(q - lower), np.min(upper - q))
            ),
            "joint_speed_ratio_max": float(
                np.max(np.abs(state[:, n : 2 * n]) / speed_limit)
            ),
        }

    def _remaps(self, desired: NDArray[np.float64]) -> tuple[int, float]:
        """Count the re-mappings and measure the position's jump at each, m.

        The jump is what the desired position changes by within the millisecond after
        the instant, less what its velocity explains.
        """
        period = (self.skill.n_steps - self.skill.overlap) / self.skill.rate
        velocity = self.log("desired_velocity")
        primitive: Any = self.station.GetSubsystemByName("fourier_primitive")
        context = primitive.GetMyContextFromRoot(self.simulator.get_context())
        count = primitive.playback_state(context).remaps
        jumps = [0.0]
        for number in range(1, count + 1):
            i = round(number * period / _FAST)
            if i + 1 < len(desired):
                expected = _FAST * (velocity[i] + velocity[i + 1]) / 2
                moved = desired[i + 1] - desired[i]
                jumps.append(float(np.linalg.norm(moved - expected)))
        return count, max(jumps)

    def html(self, duration: float) -> str:
        """Return a page of its own that replays the arm and the ink.

        Call it once, after the run; it needs `recording` and a Meshcat.
        """
        if self.meshcat is None or not self._recording:
            raise FmpError(
                "nothing was recorded; give the run a Meshcat and recording."
            )
        self.meshcat.StopRecording()
        AddInkToRecording(
            self.meshcat,
            grid=self.grid,
            X_WB=self.X_WB,
            initial_ink=self.initial_ink,
            erase_time=self.output("erase_time").reshape(self.grid.shape),
            end_time=duration,
        )
        self.meshcat.Delete("paths")
        self.meshcat.SetTransform("path", self.X_WB)
        every = round(0.02 / _FAST)
        draw_path(
            self.meshcat,
            "path/measured",
            self.log("measured_position")[::every],
            color=Rgba(0.95, 0.45, 0.10, 0.6),
            line_width=1.0,
        )
        self.meshcat.PublishRecording()
        return self.meshcat.StaticHtml()
