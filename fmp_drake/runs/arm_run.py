"""Run of a skill on an arm behind LCM messages, in real time."""

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.runs.events import RunEvent
from fmp_drake.runs.log import MILLISECOND, Chunk, Samples
from fmp_drake.runs.real_time import (
    MAX_REPLAYED,
    WallClock,
    age_metrics,
    ignored_signals,
    uninterrupted,
)
from fmp_drake.runs.station_run import StationRun
from fmp_drake.station import LcmPanda, Scenario
from fmp_drake.station.robots.panda_lcm import OpenLcm, TorquePublisher
from fmp_drake.systems import GateMode
from fmp_drake.systems.panda.arm_status import GateFault, faults_in_words
from fmp_drake.systems.panda.gate import EXPIRED_AGE, largest_change, limited_change

# Time for the controller to settle at the start before the gate opens, s.
_SETTLE = 0.3
# Steps between two checks of the page's controls, and between two updates of the metrics.
_CONTROL_STEPS, _CHUNK_STEPS = 20, 250


# Output ports of a station behind LCM, by the names of their signals in simulation.
_PORTS = {
    "actuation": "torque_measured",
    "torque": "torque_sent",
    "desired_normal_force": "page_press_force",
}


class ArmRun(StationRun):
    """Run of a skill on an arm behind LCM, with its metrics and events.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.
    config : LcmPanda
    lcm : DrakeLcmInterface, optional
        The bus instead of one of `config.url`.
    **options
        As for `StationRun`. A Meshcat shows the measured arm; its controls, if the
        scenario has them, set tempo and normal force.

    Attributes
    ----------
    desired_force : float
        Desired normal force during playback, N.
    ages : list of float
        Age of the status at each step with an open gate, s.
    late, skipped : float
        Largest delay of a step, and the sum of the skipped delays, s.
    stops : list of (float, GateFault)
        Times of the arm's stops, s of the run, and their reasons.

    Examples
    --------
    See `fmp-drake wipe --arm`.
    """

    def __init__(
        self,
        scenario: Scenario,
        skill: FourierMovementPrimitive,
        config: LcmPanda,
        *,
        lcm: DrakeLcmInterface | None = None,
        **options: Any,
    ) -> None:
        self._lcm = OpenLcm(config.url) if lcm is None else lcm
        self._config = config
        self.period = config.gate.period
        super().__init__(scenario, skill, driver=config, lcm=self._lcm, **options)
        self._tempo, self.desired_force = scenario.skill.tempo, scenario.nominal_force()
        self._has_controls = self.station.HasOutputPort("page_tempo")
        self._ticks, self._go, self._enable_time = 0, 0, np.inf
        self.ages: list[float] = []
        self.stops: list[tuple[float, GateFault]] = []
        self.late = self.skipped = 0.0
        self._last_mode = GateMode.WAITING
        for name in ("tempo", "desired_normal_force", "go", "wall_time"):
            self._set_input(name, 0.0)

    def _add_systems(self, builder: DiagramBuilder) -> None:
        self._add_sink(builder, "mode", MILLISECOND)

    def _port_name(self, signal: str) -> str:
        if signal == "desired_normal_force" and self.roles.force is not None:
            return signal
        return _PORTS.get(signal, signal)

    def _set_input(self, name: str, value: float) -> None:
        root = self.simulator.get_mutable_context()
        context = self.station.GetMyMutableContextFromRoot(root)
        self.station.GetInputPort(name).FixValue(context, np.array([value]))

    @property
    def seconds(self) -> float:
        """Time of the run without skipped delays, s."""
        return self._ticks * self.period

    @property
    def mode(self) -> GateMode:
        """Mode of the gate."""
        return GateMode(int(self.output("mode")[0]))

    @property
    def faults(self) -> GateFault:
        """Reasons for the gate's last stop."""
        return GateFault(int(self.output("faults")[0]))

    def go(self) -> None:
        """Enable the arm: it moves slowly to the skill, which then continues."""
        self.simulator.Initialize()
        self._enable_time = self.seconds + _SETTLE

    def stop(self) -> None:
        """Stop the arm: its torque goes to zero."""
        self._enable_time = np.inf
        self._set_input("go", -1.0)

    def step(self, wall_time: float) -> None:
        """Advance by one period at a wall time, s."""
        time_now = self.seconds
        self._set_input("wall_time", wall_time)
        if time_now >= self._enable_time:
            self._enable_time = np.inf
            self._go += 1
            self._set_input("go", float(self._go))
        self._ticks += 1
        self.simulator.AdvanceTo(self._ticks * self.period)
        mode = self.mode
        is_open = mode is GateMode.OPEN
        reads_controls = self._has_controls and self._ticks % _CONTROL_STEPS == 0
        if reads_controls:
            self._tempo = float(self.output("page_tempo")[0])
            if self.station.HasOutputPort("page_press_force"):
                self.desired_force = float(self.output("page_press_force")[0])
        if reads_controls or mode is not self._last_mode:
            force = self.desired_force if is_open else 0.0
            self._set_input("tempo", self._tempo if is_open else 0.0)
            self._set_input("desired_normal_force", force)
        if mode is GateMode.STOPPED and mode is not self._last_mode:
            self.stops.append((time_now, self.faults))
        self._last_mode = mode
        if is_open:
            self.ages.append(float(self.output("age")[0]))
        if self._ticks % _CHUNK_STEPS == 0:
            self._collect()

    def _update(self, chunk: Chunk) -> None:
        """Add samples; those with a closed gate are used for the limits only."""
        mode = chunk["mode"]
        is_open = mode.values[:, 0] == GateMode.OPEN
        played = {}
        for name, (times, values) in chunk.items():
            rows = is_open[np.searchsorted(mode.times, times + 1e-6) - 1]
            played[name] = Samples(times[rows], values[rows])

        always = {name: chunk[name] for name in ("state", "actuation", "torque")}
        self._metrics.update(played | always, played=played)

    def play(
        self,
        duration: float,
        operator: Callable[["ArmRun"], None],
        *,
        clock: WallClock | None = None,
    ) -> None:
        """Run in real time; at the end, or after an error, the torque is ramped to zero.

        Parameters
        ----------
        duration : float
            s.
        operator : callable
            Called after each step; it may call `go` and `stop`.
        clock : WallClock, optional
            A clock with the pace of `config` if None.
        """
        clock = clock or WallClock(self._config.pace)
        with uninterrupted():
            try:
                for now, late in clock.ticks(self.period, duration):
                    self.late = max(self.late, late)
                    if late > MAX_REPLAYED:
                        self.skipped += late
                    self.step(now)
                    operator(self)
            finally:
                with ignored_signals():
                    self.ramp_down(clock)

    def ramp_down(self, clock: WallClock) -> None:
        """Ramp the torque to zero at its rate limit, without the diagram; see `GateState`."""
        gate = self._config.gate
        torque = self.output("torque_sent")
        limit, most = np.abs(torque), largest_change(gate, gate.period)
        publish = TorquePublisher(self._lcm, self._config.command_channel)
        while np.any(torque):
            clock.sleep(gate.period)
            torque = limited_change(torque, np.zeros_like(torque), most, limit)
            publish(torque, clock.now() - EXPIRED_AGE * (not np.any(torque)))

    def metrics(self) -> dict[str, Any]:
        """Return the metrics of the run so far: those of a simulated run, and of messages.

        The normal force is an estimate by the arm. The penetration of the board is not
        measured, and the desired position jumps whenever the arm is enabled.
        """
        result = super().metrics()
        for name in ("penetration_max_m", "desired_position_jump_max_m"):
            result.pop(name, None)
        return {
            "open_seconds": len(self.ages) * self.period,
            **age_metrics("status_age", self.ages),
            "latest_step": self.late,
            "missed_ticks": round(self.skipped / self.period),
            "expiries": sum(bool(fault & GateFault.STALE) for _, fault in self.stops),
            "stops": [(time, fault.name) for time, fault in self.stops],
            **result,
        }

    def events(self) -> list[RunEvent]:
        """Return the events of the run so far, in chronological order."""
        stops = [
            RunEvent(
                t,
                t,
                "arm stopped",
                f"arm stopped at {t:.1f} s: {faults_in_words(fault)}",
            )
            for t, fault in self.stops
        ]
        return sorted([*super().events(), *stops])
