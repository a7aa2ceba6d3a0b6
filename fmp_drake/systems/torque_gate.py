"""Gate between a controller and a real Panda."""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
from drake import lcmt_panda_command, lcmt_panda_status
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, finite_array
from fmp_drake.settings import check_settings
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.interface.callbacks import (
    declare_cache,
    eval_cache,
    eval_number,
)
from fmp_drake.systems.panda.arm_status import (
    JOINTS,
    ArmReading,
    decode,
    no_status,
    read_status,
)
from fmp_drake.systems.panda.gate import (
    GateConfig,
    GateInputs,
    GateState,
    gate_step,
    initial_gate,
)

# Groups of the discrete state.
_TORQUE, _GATE, _TRACK, _COMMANDS, _READING = range(5)
# Index in the second group.
_STATUS_TIME = 2


class TorqueGate(LeafSystem):
    """Gate that sends a controller's torque to a Panda while there is no fault.

    The torque starts at 0. Once the operator has enabled the gate, it follows the
    controller's torque within the configured rate, by the wall clock. After any fault it
    goes to 0 at that rate, and stays there until the operator enables the gate again. See
    `GateFault` and `gate_step`.

    Input ports
    -----------
    torque : vector (7,)
        Torque of the controller, without gravity, Nm.
    status : abstract
        The bytes of the last ``lcmt_panda_status`` of the arm; empty before the first.
    wall_time : vector (1,)
        Time of the clock that stamps the arm's messages, s.
    go : vector (1,)
        Operator command: number of enable requests; a negative number requests a stop.
    command : abstract, optional
        The bytes of the newest ``lcmt_panda_command`` on the bus, the gate's own among
        them: another program's command is a fault.
    command_count : vector (1,), optional
        Number of commands on the bus so far: more than the gate has sent are a fault.

    Output ports
    ------------
    torque_sent : vector (7,)
        Nm; discrete state.
    state : vector (14,)
        Joint angles and velocities in the last valid status, rad and rad/s.
    torque_measured : vector (7,)
        Joint torques with gravity in the last valid status, Nm.
    torque_external : vector (7,)
        Joint torques of the contacts on the arm in the last valid status, Nm.
    mode : vector (1,)
        A `GateMode`.
    faults : vector (1,)
        A `GateFault`: the reasons of the last stop.
    age : vector (1,)
        Age of the newest status, s; infinite before the first.

    Parameters
    ----------
    config : GateConfig
    initial : array_like, shape (7,)
        Joint angles of `state` before the first status, rad.
    limits : JointLimits
        Of the arm: torques, and plausible values of a status.
    send : callable, optional
        Called with each torque (7,), Nm, and its time of the wall clock, s; not called
        while the torque stays zero.

    Raises
    ------
    SystemsError
        If a value is out of range.

    Examples
    --------
    >>> ones = np.ones(7)
    >>> limits = JointLimits(0 * ones, 3 * ones, 2 * ones, -10 * ones, 10 * ones)
    >>> gate = TorqueGate(GateConfig(), initial=np.zeros(7), limits=limits)
    >>> gate.GetOutputPort("torque_sent").Eval(gate.CreateDefaultContext())
    array([0., 0., 0., 0., 0., 0., 0.])
    """

    def __init__(
        self,
        config: GateConfig,
        *,
        initial: ArrayLike,
        limits: JointLimits,
        send: Callable[[Array, float], None] | None = None,
    ) -> None:
        super().__init__()
        self.set_name("torque_gate")
        check_settings(config, SystemsError)
        self._config, self._limits = config.completed(limits), limits
        self._send = send
        first = finite_array(
            initial, "the initial angles", (JOINTS,), error=SystemsError
        )
        finite_array(limits.speed, "the limits", (JOINTS,), error=SystemsError)
        message = AbstractValue.Make(b"")
        self._torque = self.DeclareVectorInputPort("torque", JOINTS)
        self._status = self.DeclareAbstractInputPort("status", message)
        self._wall_time = self.DeclareVectorInputPort("wall_time", 1)
        self._go = self.DeclareVectorInputPort("go", 1)
        self._command = self.DeclareAbstractInputPort("command", message)
        self._count = self.DeclareVectorInputPort("command_count", 1)
        torque_index, gate_index, *_ = map(
            self.DeclareDiscreteState, initial_gate().vectors()
        )
        read_index = self.DeclareDiscreteState(np.r_[first, np.zeros(3 * JOINTS)])
        self._reading = declare_cache(
            self, "reading", self._calc_reading, {self._status.ticket()}
        )
        self._last_command = declare_cache(
            self, "last command", self._calc_command, {self._command.ticket()}
        )
        gate_ticket = self.discrete_state_ticket(gate_index)
        # The outputs follow a valid message without delay.
        measurement = {
            self.cache_entry_ticket(self._reading),
            gate_ticket,
            self.discrete_state_ticket(read_index),
        }
        self.DeclareStateOutputPort("torque_sent", torque_index)
        for name, first_row, rows in (
            ("state", 0, 2),
            ("torque_measured", 2, 1),
            ("torque_external", 3, 1),
        ):
            part = slice(first_row * JOINTS, (first_row + rows) * JOINTS)
            calc = partial(self._calc_measurement, part)
            self.DeclareVectorOutputPort(name, rows * JOINTS, calc, measurement)
        for i, name in enumerate(("mode", "faults")):
            calc = partial(self._calc_gate, i)
            self.DeclareVectorOutputPort(name, 1, calc, {gate_ticket})
        age_tickets = {gate_ticket, self._wall_time.ticket()}
        self.DeclareVectorOutputPort("age", 1, self._calc_age, age_tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(config.period, 0.0, self._publish)

    def _calc_reading(self, context: Any, value: Any) -> None:
        data = cast(bytes, self._status.Eval(context))
        value.set_value(
            read_status(decode(lcmt_panda_status, data)) if data else no_status()
        )

    def _calc_command(self, context: Any, value: Any) -> None:
        data = b""
        if self._command.HasValue(context):
            data = cast(bytes, self._command.Eval(context))
        value.set_value(decode(lcmt_panda_command, data))

    def _state(self, context: Context) -> GateState:
        discrete = context.get_discrete_state()
        return GateState.from_vectors(
            *(discrete.value(i) for i in (_TORQUE, _GATE, _TRACK, _COMMANDS))
        )

    def _measurement(self, context: Context) -> Any:
        """Return the numbers of the last valid status, shape (28,)."""
        reading = cast(ArmReading, eval_cache(self, self._reading, context))
        discrete = context.get_discrete_state()
        if reading.is_finite and reading.time >= discrete.value(_GATE)[_STATUS_TIME]:
            return np.concatenate(reading[1:4])
        return discrete.value(_READING)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        inputs = GateInputs(
            reading=cast(ArmReading, eval_cache(self, self._reading, context)),
            command=eval_cache(self, self._last_command, context),
            command_count=eval_number(self._count, context, 0.0),
            torque=np.array(self._torque.Eval(context)),
            wall_time=eval_number(self._wall_time, context),
            go=eval_number(self._go, context),
        )
        before = self._state(context)
        state = gate_step(self._config, before, inputs, limits=self._limits)
        values.set_value(_READING, self._measurement(context))
        for index, vector in enumerate(state.vectors()):
            values.set_value(index, vector)

    def _publish(self, context: Context) -> None:
        if self._send is None:
            return
        state = self._state(context)
        if state.is_live:
            self._send(state.torque, state.command_time)

    def _calc_measurement(
        self, part: slice, context: Context, output: BasicVector
    ) -> None:
        output.SetFromVector(self._measurement(context)[part])

    def _calc_gate(self, i: int, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, context.get_discrete_state(_GATE).value()[i])

    def _calc_age(self, context: Context, output: BasicVector) -> None:
        gate = context.get_discrete_state().value(_GATE)
        wall_time = eval_number(self._wall_time, context)
        output.SetAtIndex(0, wall_time - gate[_STATUS_TIME])
