"""
The primitive in your diagram
=============================

`FourierPrimitiveSystem` is a `LeafSystem` with ports for position, velocity, acceleration and
covariance. Here a spring and a damper pull a point mass of 1 kg along its path; they represent
your controller and your plant.
"""

import matplotlib.pyplot as plt
import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, Rgba
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
from fmp_drake.station import SetStage, models_dir
from fmp_drake.systems import (
    AddPathToRecording,
    FourierPrimitiveSystem,
    InlinePage,
    draw_demonstrations,
)

STIFFNESS = 400.0  # N/m
DAMPING = 40.0  # Ns/m

recording = Demonstration.load(models_dir() / "demonstrations" / "polishing.npz")
skill = FourierMovementPrimitive().fit(recording)

builder = DiagramBuilder()
primitive = builder.AddSystem(FourierPrimitiveSystem(skill))

# %%
# A point mass has the state (position, velocity), the input force, and its state as output. The
# primitive reads the measured position once, to start from there.

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
builder.Connect(position, primitive.GetInputPort("measured_position"))

# %%
# Force = acceleration + D (desired - velocity) + K (desired - position), for a mass of 1 kg.

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
measured_log = LogVectorOutput(position, builder, 0.01)
diagram = builder.Build()

# %%
# Start at rest, 20 cm beside the movement and 10 cm above it, and simulate 30 s.

simulator = Simulator(diagram)
context = simulator.get_mutable_context()
mass.GetMyMutableContextFromRoot(context).SetContinuousState(
    [0.2, 0.2, 0.1, 0.0, 0.0, 0.0]
)
simulator.AdvanceTo(30.0)

desired = desired_log.FindLog(context).data().T
log = measured_log.FindLog(context)
measured = log.data().T
error = np.linalg.norm(desired - measured, axis=1)
print(f"tracking error {1e3 * np.sqrt(np.mean(error**2)):.2f} mm rms for 30 s")
state = primitive.playback_state(primitive.GetMyContextFromRoot(context))
print(f"re-mapped {state.remaps} times")

figure, ax = plt.subplots(figsize=(5, 5), layout="constrained")
ax.plot(*recording.values.T[[1, 0]], color="0.85", linewidth=0.5, label="demonstrated")
ax.plot(*measured.T[[1, 0]], color="tab:orange", linewidth=1, label="the mass")
ax.set(xlabel="y (m)", ylabel="x (m)", aspect="equal")
ax.invert_xaxis()
ax.legend()
plt.show()

# %%
# The same in Meshcat, in 3D; a notebook shows the page here.

meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
SetStage(meshcat, eye=[-0.3, 0.0, 0.35], target=[0.0, 0.0, 0.0])
draw_demonstrations(meshcat, "demonstrated", [recording.values])
times, color = log.sample_times(), Rgba(1.0, 0.5, 0.0)
AddPathToRecording(meshcat, "mass", times=times, points=measured, color=color)
meshcat.PublishRecording()
InlinePage(meshcat.StaticHtml())
