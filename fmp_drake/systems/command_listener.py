"""Newest command on an arm's LCM bus, and the number of commands."""

from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import Context, LeafSystem, State
from pydrake.systems.lcm import LcmSubscriberSystem, SerializerInterface


class CommandListener(LeafSystem):
    """Newest command on an LCM channel, and the number of commands so far.

    An `LcmSubscriberSystem` keeps the newest message only. The count tells whether
    others came before it; both are read at the same instant. Another system, such as an
    `LcmInterfaceSystem`, must handle the subscriptions of the bus.

    Output ports
    ------------
    command : abstract
        The bytes of the newest message; empty before the first.
    count : vector (1,)
        Number of messages so far.

    Parameters
    ----------
    lcm : DrakeLcmInterface
    channel : str
    serializer : SerializerInterface
        For raw bytes.
    period : float
        Time between two readings, s.
    """

    def __init__(
        self,
        lcm: DrakeLcmInterface,
        channel: str,
        *,
        serializer: SerializerInterface,
        period: float,
    ) -> None:
        super().__init__()
        self.set_name("command")
        self._subscriber = LcmSubscriberSystem(
            channel=channel, serializer=serializer, lcm=lcm
        )
        count = self.DeclareDiscreteState(1)
        command = self.DeclareAbstractState(AbstractValue.Make(b""))
        self.DeclareStateOutputPort("command", command)
        self.DeclareStateOutputPort("count", count)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._listen)

    def _listen(self, context: Context, state: State) -> None:
        before = int(context.get_discrete_state_vector()[0])
        data: Any = state.get_mutable_abstract_state(0)
        # The smallest timeout: zero would wait for ever.
        count = self._subscriber.WaitForMessage(before, data, 1e-9)
        state.get_mutable_discrete_state().get_mutable_vector(0).SetAtIndex(0, count)
