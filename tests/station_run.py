"""A station with loggers on its output ports, for the tests of stations."""

import copy

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

MILLISECOND, SELDOM = 0.001, 0.05
# What Drake finds for half the time of a simulated millisecond, and how often it is.
CONTACT, OFTEN = ("normal_force", "contact_area"), 0.01

LIMITED = ("state", "actuation", "torque")


class StationRun:
    """Logs what is small every millisecond; the rest and the covariance every 50 ms.

    The force and the area of the contact are logged every 10 ms.

    Logging all ports takes as long as the simulation: name those that are looked at,
    beside the `LIMITED`.
    """

    def __init__(self, station, *names):
        self.station = station
        builder = DiagramBuilder()
        builder.AddSystem(station)
        self._sinks = {}
        for i in range(station.num_output_ports()):
            port = station.get_output_port(i)
            if names and port.get_name() not in (*LIMITED, *names):
                continue
            small = port.size() <= 14 and port.get_name() != "covariance"
            period = MILLISECOND if small else SELDOM
            period = OFTEN if port.get_name() in CONTACT else period
            sink = LogVectorOutput(port, builder, period)
            sink.set_name(f"log_{port.get_name()}")
            self._sinks[port.get_name()] = sink
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)

    def from_context(self, context):
        """Return a run of the same station that goes on from a context."""
        run = copy.copy(self)
        run.simulator = Simulator(self.diagram, context)
        return run

    @property
    def names(self):
        return tuple(self._sinks)

    def advance(self, until):
        self.simulator.AdvanceTo(until)
        return self

    def log(self, name):
        """Return the logged values, shape (samples, size)."""
        return self._sinks[name].FindLog(self.simulator.get_context()).data().T.copy()

    def logs(self):
        return {name: self.log(name) for name in self._sinks}

    def context_of(self, name):
        """Return the context of a system of the station."""
        system = self.station.GetSubsystemByName(name)
        return system.GetMyContextFromRoot(self.simulator.get_context())

    def restart(self):
        """Set the same simulator back to the start of everything."""
        context = self.simulator.get_mutable_context()
        self.diagram.SetDefaultContext(context)
        context.SetTime(0.0)
        for sink in self._sinks.values():
            sink.FindMutableLog(context).Clear()
        self.simulator.Initialize()
        return self


def check_limits(run):
    """Check the arm's joints against the limits of its model."""
    plant = run.station.GetSubsystemByName("plant")
    state, actuation, torque = (run.log(n) for n in LIMITED)
    q, v = state[:, :7], state[:, 7:]
    assert np.all(np.isfinite(state))
    assert np.all(q > plant.GetPositionLowerLimits()[:7])
    assert np.all(q < plant.GetPositionUpperLimits()[:7])
    assert np.all(np.abs(v) < plant.GetVelocityUpperLimits()[:7])
    assert np.all(np.abs(actuation) < plant.GetEffortUpperLimits()[:7])
    # Franka's robots stop beyond 1000 Nm/s.
    assert np.max(np.abs(np.diff(torque, axis=0))) < 1000 * MILLISECOND
