"""The last system before a real arm: no torque passes that the arm might not bear."""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
from drake import lcmt_panda_status
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import as_floats
from fmp_drake.settings import check_settings
from fmp_drake.systems.framework.callbacks import declare_cache, eval_cache
from fmp_drake.systems.panda.firmware import torque_command
from fmp_drake.systems.panda.gating import (
    GateConfig,
    GateState,
    gate_step,
    initial_gate,
)
from fmp_drake.systems.panda.reading import (
    JOINTS,
    ArmReading,
    decode,
    read_status,
)

# Groups of the discrete state.
_TORQUE, _GATE, _READING = range(3)
# In the second.
_STATUS_TIME = 2


class TorqueGate(LeafSystem):
    """Lets a controller's torque through to an arm while everything is as it must be.

    The torque begins at 0 and, once the operator has said go, follows the
    controller's, never faster than the configured rate of the wall clock, whatever
    was missed. At any fault it goes to 0 at that rate, and stays there until the operator
    says go again. See `GateFault` and `gate_step`.

    Input ports
    -----------
    torque : vector (7,)
        Wanted, without gravity, Nm.
    status : abstract
        The bytes of the last ``lcmt_panda_status`` of the arm.
    wall_time : vector (1,)
        s; the clock that the arm's messages are stamped with.
    go : vector (1,)
        How many times the operator has said go; less than 0 for a stop.

    Output ports
    ------------
    torque_sent : vector (7,)
        Nm; discrete state.
    state : vector (14,)
        Angles and speeds of the arm, rad and rad/s, of the last good status.
    torque_measured : vector (7,)
        With gravity, Nm, of the last good status.
    torque_external : vector (7,)
        Of what touches the arm, on the arm, Nm, of the last good status.
    mode : vector (1,)
        A `GateMode`.
    faults : vector (1,)
        A `GateFault`: why the torque went to zero.
    age : vector (1,)
        Of the newest status, s; infinite before the first.

    Parameters
    ----------
    config : GateConfig
    initial : array_like, shape (7,)
        Angles that `state` shows before the first status, rad.
    send : callable, optional
        Called with each torque to be sent, as an encoded ``lcmt_panda_command`` that is
        stamped with the wall clock; with none while the torque is to stay zero.

    Raises
    ------
    SystemsError
        If a value is out of range.

    Examples
    --------
    >>> gate = TorqueGate(GateConfig(), initial=np.zeros(7))
    >>> gate.GetOutputPort("torque_sent").Eval(gate.CreateDefaultContext())
    array([0., 0., 0., 0., 0., 0., 0.])
    """

    def __init__(
        self,
        config: GateConfig,
        *,
        initial: ArrayLike,
        send: Callable[[bytes], None] | None = None,
    ) -> None:
        super().__init__()
        self.set_name("torque_gate")
        check_settings(config, SystemsError)
        self._config, self._send = config, send
        first = as_floats(initial, "the initial angles", (JOINTS,), error=SystemsError)
        torque = self.DeclareVectorInputPort("torque", JOINTS)
        status = self.DeclareAbstractInputPort("status", AbstractValue.Make(b""))
        wall_time = self.DeclareVectorInputPort("wall_time", 1)
        go = self.DeclareVectorInputPort("go", 1)
        self._torque, self._status, self._wall_time, self._go = (
            torque, status, wall_time, go,
        )  # fmt: skip
        sent, rest = initial_gate().vectors()
        sent_index = self.DeclareDiscreteState(sent)
        gate_index = self.DeclareDiscreteState(rest)
        read_index = self.DeclareDiscreteState(np.r_[first, np.zeros(3 * JOINTS)])
        self._reading = declare_cache(
            self,
            "reading",
            self._calc_reading,
            {status.ticket()},
            allocate=lambda: AbstractValue.Make(read_status(None)),
        )
        gate_ticket = self.discrete_state_ticket(gate_index)
        # What is good in a message is seen at once.
        seen = {
            self.cache_entry_ticket(self._reading),
            gate_ticket,
            self.discrete_state_ticket(read_index),
        }
        self.DeclareStateOutputPort("torque_sent", sent_index)
        for name, first_row, rows in (
            ("state", 0, 2),
            ("torque_measured", 2, 1),
            ("torque_external", 3, 1),
        ):
            part = slice(first_row * JOINTS, (first_row + rows) * JOINTS)
            self.DeclareVectorOutputPort(
                name,
                rows * JOINTS,
                partial(self._calc_seen, part),
                prerequisites_of_calc=seen,
            )
        for i, name in enumerate(("mode", "faults")):
            self.DeclareVectorOutputPort(
                name,
                1,
                partial(self._calc_gate, i),
                prerequisites_of_calc={gate_ticket},
            )
        self.DeclareVectorOutputPort(
            "age",
            1,
            self._calc_age,
            prerequisites_of_calc={gate_ticket, wall_time.ticket()},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(config.period, 0.0, self._publish)

    def _calc_reading(self, context: Any, value: Any) -> None:
        data = cast(bytes, self._status.Eval(context))
        value.set_value(read_status(decode(lcmt_panda_status, data)))

    def _state(self, context: Context) -> GateState:
        discrete = context.get_discrete_state()
        return GateState.from_vectors(discrete.value(_TORQUE), discrete.value(_GATE))

    def _seen(self, context: Context) -> Any:
        """Return the numbers of the last good status."""
        reading = cast(ArmReading, eval_cache(self, self._reading, context))
        discrete = context.get_discrete_state()
        if reading.is_finite and reading.time >= discrete.value(_GATE)[_STATUS_TIME]:
            return np.concatenate(reading[1:4])
        return discrete.value(_READING)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        wall_time: Any = self._wall_time.Eval(context)
        go: Any = self._go.Eval(context)
        after = gate_step(
            self._config,
            self._state(context),
            reading=cast(ArmReading, eval_cache(self, self._reading, context)),
            torque=np.array(self._torque.Eval(context)),
            wall_time=float(wall_time[0]),
            go=float(go[0]),
        )
        torque, rest = after.vectors()
        values.set_value(_READING, self._seen(context))
        values.set_value(_TORQUE, torque)
        values.set_value(_GATE, rest)

    def _publish(self, context: Context) -> None:
        if self._send is None:
            return
        state = self._state(context)
        if state.is_live:
            self._send(torque_command(state.torque, state.stamp).encode())

    def _calc_seen(self, part: slice, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._seen(context)[part])

    def _calc_gate(self, i: int, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, context.get_discrete_state(_GATE).value()[i])

    def _calc_age(self, context: Context, output: BasicVector) -> None:
        wall_time: Any = self._wall_time.Eval(context)
        gate = context.get_discrete_state().value(_GATE)
        output.SetAtIndex(0, wall_time[0] - gate[_STATUS_TIME])
