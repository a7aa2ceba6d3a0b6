"""The whole station beside its bare plant, and the time of each system.

The bare plant is the same plant with the same scene graph and contact, fed with the
torques that the closed loop commanded at every millisecond.
"""

from collections import defaultdict
from contextlib import contextmanager
from functools import cache, wraps
from time import perf_counter

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    LogVectorOutput,
    TrajectorySource,
    ZeroOrderHold,
)
from pydrake.trajectories import PiecewisePolynomial

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.station import MakeWipingStation

TICK = 0.001


@cache
def wiping_skill():
    path = models_dir() / "demonstrations" / "wiping.npz"
    return FourierMovementPrimitive().fit(Demonstration.load(path))


def make_station(scenario, panel=None):
    meshcat = None if panel is None else panel.meshcat
    return MakeWipingStation(scenario, wiping_skill(), meshcat=meshcat, panel=panel)


def make_simulator(diagram, scenario):
    simulator = Simulator(diagram)
    if scenario.plant.time_step == 0:
        ApplySimulatorConfig(scenario.simulator, simulator)
    simulator.Initialize()
    return simulator


def record(scenario, seconds):
    """Return times, shape (N,), and the torque in the millisecond after, (7, N)."""
    builder = DiagramBuilder()
    station = builder.AddSystem(make_station(scenario))
    log = LogVectorOutput(station.GetOutputPort("torque"), builder, TICK)
    simulator = make_simulator(builder.Build(), scenario)
    simulator.AdvanceTo(seconds)
    found = log.FindLog(simulator.get_context())
    times, torque = found.sample_times().copy(), found.data().copy()
    if scenario.plant.time_step > 0:
        return times, torque
    # The log shows the torque before the update of the instant.
    return times[:-1], torque[:, 1:]


def make_bare(scenario, times, torques):
    """Return the plant alone with its torques."""
    builder = DiagramBuilder()
    scene = AddBoardScene(builder, scenario, start=scenario.start)
    held = PiecewisePolynomial.ZeroOrderHold(times, torques)
    source = builder.AddSystem(TrajectorySource(held))
    torque = source.get_output_port()
    if scenario.plant.time_step == 0:
        # An integrator must be told where the torque jumps.
        hold = builder.AddSystem(ZeroOrderHold(TICK, len(torques)))
        builder.Connect(torque, hold.get_input_port())
        torque = hold.get_output_port()
    builder.Connect(torque, scene.plant.get_actuation_input_port(scene.robot.arm))
    return builder.Build()


def make_scene(scenario):
    """Return the plant and its scene graph alone."""
    builder = DiagramBuilder()
    AddBoardScene(builder, scenario, start=scenario.start)
    return builder.Build()


def _plant_and_context(simulator):
    plant = simulator.get_system().GetSubsystemByName("plant")
    return plant, plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())


def plant_state(simulator):
    plant, context = _plant_and_context(simulator)
    return plant.GetPositionsAndVelocities(context).copy()


def take_turns(simulators, *, warm_up, slices, follow=False):
    """Advance simulators in turns of 1 s, so that a busy machine slows all.

    Returns
    -------
    seconds : array, shape (slices, k)
    difference : float
        Largest one of the plants' states, rad and rad/s, from that of the first.

    With `follow` they begin each slice at the state of the first: open loop, a
    continuous plant goes its own way with every rounding.
    """
    for simulator in simulators:
        simulator.AdvanceTo(warm_up)
    first, *others = simulators
    seconds, difference = np.empty((slices, len(simulators))), 0.0
    for row in range(slices):
        if follow:
            for simulator in others:
                plant, context = _plant_and_context(simulator)
                plant.SetPositionsAndVelocities(context, plant_state(first))
        # The first of a turn is another one every time.
        for shift in range(len(simulators)):
            column = (row + shift) % len(simulators)
            begin = perf_counter()
            simulators[column].AdvanceTo(warm_up + row + 1)
            seconds[row, column] = perf_counter() - begin
        for simulator in others:
            off = np.abs(plant_state(simulator) - plant_state(first)).max()
            difference = max(difference, off)
    return seconds, difference


class CallbackTimes:
    """Seconds in the Python callbacks of each system, without those they call."""

    def __init__(self):
        self.seconds = defaultdict(float)
        self._open = []

    def timed(self, system, callback):
        @wraps(callback)
        def call(*arguments, **keywords):
            begin = perf_counter()
            self._open.append(0.0)
            try:
                return callback(*arguments, **keywords)
            finally:
                took = perf_counter() - begin
                self.seconds[system.get_name()] += took - self._open.pop()
                if self._open:
                    self._open[-1] += took

        return call


@contextmanager
def timed_callbacks():
    """Time the callbacks of every Python system that is made in this context."""
    times = CallbackTimes()
    names = [
        name
        for name in dir(LeafSystem)
        if name.startswith("Declare") and name.endswith(("OutputPort", "Event"))
    ]
    original = {name: getattr(LeafSystem, name) for name in names}

    def declaring(declare):
        def call(system, *arguments, **keywords):
            def wrapped(value):
                return times.timed(system, value) if _is_python(value) else value

            return declare(
                system,
                *map(wrapped, arguments),
                **{key: wrapped(value) for key, value in keywords.items()},
            )

        return call

    for name, declare in original.items():
        setattr(LeafSystem, name, declaring(declare))
    try:
        yield times
    finally:
        for name, declare in original.items():
            setattr(LeafSystem, name, declare)


def _is_python(value):
    return hasattr(value, "__code__") or hasattr(value, "__func__")
