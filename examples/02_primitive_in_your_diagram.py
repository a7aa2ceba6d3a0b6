"""Wire FourierPrimitiveSystem into a diagram of your own and step it.

    python examples/02_primitive_in_your_diagram.py

The robot here is a point mass of 1 kg that a spring and a damper pull along the desired
path: stand-ins for your plant and your controller.
"""

from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    Demultiplexer,
    Gain,
    LinearSystem,
    LogVectorOutput,
)

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.systems import FourierPrimitiveSystem

BUNDLED = Path(__file__).parent.parent / "models" / "demonstrations" / "polishing.npz"
STIFFNESS = 400.0  # N/m
DAMPING = 40.0  # Ns/m


def main() -> None:
    skill = FourierMovementPrimitive().fit(Demonstration.load(BUNDLED))

    builder = DiagramBuilder()
    primitive = builder.AddSystem(FourierPrimitiveSystem(skill))

    # A point mass: state [position, velocity], input force, output state.
    zero, one = np.zeros((3, 3)), np.eye(3)
    mass = builder.AddSystem(
        LinearSystem(
            A=np.block([[zero, one], [zero, zero]]),
            B=np.vstack([zero, one]),
            C=np.eye(6),
            D=np.zeros((6, 3)),
        )
    )
    split = builder.AddSystem(Demultiplexer(6, 3))
    builder.Connect(mass.get_output_port(), split.get_input_port())
    position, velocity = split.get_output_port(0), split.get_output_port(1)

    # The primitive reads the measured position once, to start from there.
    builder.Connect(position, primitive.GetInputPort("measured_position"))

    # Force = acceleration + D (desired - velocity) + K (desired - position), mass 1.
    force = builder.AddSystem(Adder(5, 3))
    terms = (
        (primitive.GetOutputPort("acceleration"), 1.0),
        (primitive.GetOutputPort("velocity"), DAMPING),
        (velocity, -DAMPING),
        (primitive.GetOutputPort("position"), STIFFNESS),
        (position, -STIFFNESS),
    )
    for i, (port, factor) in enumerate(terms):
        gain = builder.AddSystem(Gain(factor, 3))
        builder.Connect(port, gain.get_input_port())
        builder.Connect(gain.get_output_port(), force.get_input_port(i))
    builder.Connect(force.get_output_port(), mass.get_input_port())

    desired_log = LogVectorOutput(primitive.GetOutputPort("position"), builder, 0.01)
    component_log = LogVectorOutput(primitive.GetOutputPort("component"), builder, 0.05)
    measured_log = LogVectorOutput(position, builder, 0.01)
    diagram = builder.Build()

    # Start 20 cm beside the movement and 10 cm above it, at rest.
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    mass.GetMyMutableContextFromRoot(context).SetContinuousState(
        [0.2, 0.2, 0.1, 0.0, 0.0, 0.0]
    )
    simulator.AdvanceTo(30.0)

    desired = desired_log.FindLog(context).data().T
    measured = measured_log.FindLog(context).data().T
    components = component_log.FindLog(context).data()[0].astype(int)
    error = np.linalg.norm(desired - measured, axis=1)
    print(f"start: desired {desired[0].round(3)}, measured {measured[0].round(3)}")
    print(f"followed to {1e3 * np.sqrt(np.mean(error**2)):.2f} mm rms for 30 s")
    print(f"components played: {components[np.r_[True, np.diff(components) != 0]]}")
    state = primitive.playback_state(primitive.GetMyContextFromRoot(context))
    print(f"re-mapped {state.remaps} times")


if __name__ == "__main__":
    main()
