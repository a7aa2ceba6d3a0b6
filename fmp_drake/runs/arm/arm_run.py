"""A skill on an arm behind LCM messages, in the time of the wall clock."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.analysis import Simulator

from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.runs.arm.real_time import (
    MOST_REPLAYED,
    WallClock,
    age_metrics,
    undisturbed,
)
from fmp_drake.runs.metrics import ForceMetrics, Samples
from fmp_drake.station.board_station import MakeSkillStation
from fmp_drake.station.panda_driver import LcmPanda, OpenLcm
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.panda.firmware import torque_command
from fmp_drake.systems.panda.gating import (
    GateMode,
    greatest_change,
    limited_change,
)
from fmp_drake.systems.panda.reading import GateFault

# Until the controller has settled on the start, before the gate opens, s.
_SETTLE = 0.3
# Steps between two samples of what costs as much as a step.
_SELDOM = 20


class ArmRun:
    """Plays a skill on an arm behind LCM, with its safety, until the end or a stop.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.
    config : LcmPanda
    lcm : DrakeLcmInterface, optional
        The bus instead of one of `config.url`.
    meshcat : Meshcat, optional
        Where to show the measured arm. Only where the scenario shows controls they say tempo
        and normal force.
    demonstrated : sequence of ndarray, shape (N, 3)
        Paths in B to show, m.

    Attributes
    ----------
    ages : list of float
        Of the status at each step with an open gate, s.
    errors : list of float
        Distances to the path, every 20 steps with an open gate, m.
    late, skipped : float
        Greatest lateness of a step, and the sum of what was not made up for, s.
    stops : list of (float, GateFault)
        When the arm was stopped, s of the run, and why.

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
        meshcat: Meshcat | None = None,
        demonstrated: Sequence[NDArray[np.float64]] = (),
    ) -> None:
        self._lcm = OpenLcm(config.url) if lcm is None else lcm
        self._config = config
        self.period = config.gate.period
        self._tempo, self._force = scenario.skill.tempo, scenario.press.force
        self.station = MakeSkillStation(
            scenario,
            skill,
            config,
            lcm=self._lcm,
            meshcat=meshcat,
            demonstrated=demonstrated,
        )
        self._has_controls = self.station.HasOutputPort("page_tempo")
        self.simulator = Simulator(self.station)
        self._ticks, self._go, self._settled = 0, 0, np.inf
        self.ages: list[float] = []
        self.errors: list[float] = []
        self._forces = ForceMetrics(scenario.press.force)
        self.stops: list[tuple[float, GateFault]] = []
        self.late = self.skipped = 0.0
        self._last_mode = GateMode.WAITING
        self._fix("tempo", 0.0)
        self._fix("desired_normal_force", 0.0)
        self._fix("go", 0.0)
        self._fix("wall_time", 0.0)

    def _fix(self, name: str, value: float) -> None:
        context = self.simulator.get_mutable_context()
        self.station.GetInputPort(name).FixValue(context, np.array([value]))

    def output(self, name: str) -> NDArray[np.float64]:
        """Return what an output port of the station says now."""
        value: Any = self.station.GetOutputPort(name).Eval(self.simulator.get_context())
        return np.array(value)

    @property
    def seconds(self) -> float:
        """Since the begin, without what was missed."""
        return self._ticks * self.period

    @property
    def mode(self) -> GateMode:
        """Whether torque goes to the arm."""
        return GateMode(int(self.output("mode")[0]))

    @property
    def faults(self) -> GateFault:
        """Why it does not."""
        return GateFault(int(self.output("faults")[0]))

    def go(self) -> None:
        """Say go: the skill begins anew from where the arm is."""
        self.simulator.Initialize()
        self._settled = self.seconds + _SETTLE

    def stop(self) -> None:
        """Let the torque go to zero."""
        self._settled = np.inf
        self._fix("go", -1.0)

    def step(self, wall_time: float) -> None:
        """Advance by one period at a wall time, s."""
        time_now = self.seconds
        self._fix("wall_time", wall_time)
        if time_now >= self._settled:
            self._settled = np.inf
            self._go += 1
            self._fix("go", float(self._go))
        self._ticks += 1
        self.simulator.AdvanceTo(self._ticks * self.period)
        mode, seldom = self.mode, self._ticks % _SELDOM == 0
        is_open = mode is GateMode.OPEN
        if seldom and self._has_controls:
            self._tempo = float(self.output("page_tempo")[0])
            self._force = float(self.output("page_normal_force")[0])
        if mode is not self._last_mode or (seldom and self._has_controls):
            self._fix("tempo", self._tempo if is_open else 0.0)
            self._fix("desired_normal_force", self._force if is_open else 0.0)
        if mode is GateMode.STOPPED and mode is not self._last_mode:
            self.stops.append((time_now, self.faults))
        self._last_mode = mode
        if is_open:
            self.ages.append(float(self.output("age")[0]))
            if seldom:
                error = self.output("tracking_error")[3:]
                self.errors.append(float(np.linalg.norm(error)))
                force = self.output("normal_force")[None]
                sample = Samples(np.array([time_now]), force)
                self._forces.update({"normal_force": sample})

    def play(
        self,
        duration: float,
        operator: Callable[["ArmRun"], None],
        *,
        clock: WallClock | None = None,
    ) -> None:
        """Run in real time, and end with a ramp of the torque to zero, whatever ends it.

        Parameters
        ----------
        duration : float
            s.
        operator : callable
            Called after each step; it may say `go` and `stop`.
        clock : WallClock, optional
            That of the configuration where None.
        """
        clock = clock or WallClock(self._config.pace)
        with undisturbed():
            try:
                for now, late in clock.ticks(self.period, duration):
                    self.late = max(self.late, late)
                    if late > MOST_REPLAYED:
                        self.skipped += late
                    self.step(now)
                    operator(self)
            finally:
                self.ramp_down(clock)

    def ramp_down(self, clock: WallClock) -> None:
        """Send less and less torque until it is zero, without the diagram."""
        gate = self._config.gate
        torque = self.output("torque_sent")
        limit, most = np.array(gate.max_torque), greatest_change(gate, gate.period)
        while np.any(torque):
            clock.sleep(gate.period)
            torque = limited_change(torque, np.zeros_like(torque), most, limit)
            message = torque_command(torque, clock.now())
            self._lcm.Publish(self._config.command_channel, message.encode())

    def metrics(self) -> dict[str, Any]:
        """Return what was measured: s, m, N; the force is what the arm feels of it."""
        rms = float(np.sqrt(np.mean(np.square(self.errors)))) if self.errors else None
        expired = [fault for _, fault in self.stops if fault & GateFault.STALE]
        return {
            "open_seconds": len(self.ages) * self.period,
            **age_metrics("status_age", self.ages),
            "latest_step": self.late,
            "missed_ticks": round(self.skipped / self.period),
            "expiries": len(expired),
            "stops": [(at, fault.name) for at, fault in self.stops],
            "tracking_rms": rms,
            **self._forces.result(),
        }
