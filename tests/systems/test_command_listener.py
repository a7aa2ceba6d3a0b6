"""Facts about the commands that are heard on the bus of an arm."""

import pytest
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmInterfaceSystem

from fmp_drake.station.robots.panda_lcm import RawSerializer
from fmp_drake.systems.command_listener import CommandListener


@pytest.fixture
def bus():
    return DrakeLcm("memq://")


@pytest.fixture
def simulator(bus):
    builder = DiagramBuilder()
    builder.AddSystem(LcmInterfaceSystem(bus))
    listener = builder.AddSystem(
        CommandListener(bus, "COMMAND", serializer=RawSerializer(), period=1e-3)
    )
    for name in ("command", "count"):
        builder.ExportOutput(listener.GetOutputPort(name), name)
    return Simulator(builder.Build())


def heard(simulator):
    """Advance by 2 ms; return the newest command and the count."""
    context = simulator.get_context()
    simulator.AdvanceTo(context.get_time() + 2e-3)
    diagram = simulator.get_system()
    command, count = (
        diagram.GetOutputPort(name).Eval(context) for name in ("command", "count")
    )
    return command, count.tolist()


def test_every_message_counts_and_the_newest_is_kept(bus, simulator):
    assert heard(simulator) == (b"", [0.0])
    bus.Publish("COMMAND", b"one")
    assert heard(simulator) == (b"one", [1.0])
    for data in (b"two", b"three", b"three"):
        bus.Publish("COMMAND", data)
    bus.Publish("STATUS", b"four")
    assert heard(simulator) == (b"three", [4.0])
    assert heard(simulator) == (b"three", [4.0])


def test_a_copy_of_the_context_keeps_what_was_heard(bus, simulator):
    bus.Publish("COMMAND", b"one")
    heard(simulator)
    copy = simulator.get_context().Clone()
    bus.Publish("COMMAND", b"two")
    assert heard(simulator) == (b"two", [2.0])
    diagram = simulator.get_system()
    assert diagram.GetOutputPort("command").Eval(copy) == b"one"
    assert diagram.GetOutputPort("count").Eval(copy).tolist() == [1.0]


def test_nothing_feeds_through(simulator):
    assert simulator.get_system().num_input_ports() == 0
    assert not simulator.get_system().HasAnyDirectFeedthrough()
