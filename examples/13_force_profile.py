"""
A force that follows the movement
=================================

The desired normal force is an input port like any other. Here it is a function of the position of
the tool: large on the right half of the board, small on the left. A trajectory or a fourth learned
channel can drive the same port.
"""

# sphinx_gallery_thumbnail_path = '../../models/scenarios/polish_pipe.png'

import matplotlib.pyplot as plt
import numpy as np
from pydrake.symbolic import Variable, tanh
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Demultiplexer,
    LogVectorOutput,
    SymbolicVectorSystem,
)

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import (
    AddArmController,
    AddBoardScene,
    AddInk,
    LoadScenario,
    models_dir,
)
from fmp_drake.systems import FourierPrimitiveSystem

recording = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
skill = FourierMovementPrimitive().fit(recording)
scenario = LoadScenario("table_top")

# %%
# The parts of the wiping station, wired by hand
# ----------------------------------------------

builder = DiagramBuilder()
scene = AddBoardScene(builder, scenario, start=[0.0, 0.1, 0.05])
controller = AddArmController(builder, scene, scenario.impedance)
ink = AddInk(builder, scene)
primitive = builder.AddSystem(FourierPrimitiveSystem(skill))
builder.Connect(
    controller.GetOutputPort("measured_position"),
    primitive.GetInputPort("measured_position"),
)
motion = builder.AddSystem(Demultiplexer([3, 3, 3]))
builder.Connect(primitive.GetOutputPort("motion"), motion.get_input_port())
for i, order in enumerate(("position", "velocity", "acceleration")):
    builder.Connect(
        motion.get_output_port(i), controller.GetInputPort(f"desired_{order}")
    )

# %%
# The profile is 6 N on one side and 14 N on the other, with a smooth transition.

x, y, z = (Variable(name) for name in "xyz")
profile = builder.AddSystem(
    SymbolicVectorSystem(
        time=None,
        state=[],
        input=[x, y, z],
        dynamics=[],
        output=[10.0 - 4.0 * tanh(y / 0.03)],
    )
)
builder.Connect(motion.get_output_port(0), profile.get_input_port())
builder.Connect(
    profile.get_output_port(), controller.GetInputPort("desired_normal_force")
)

desired_log = LogVectorOutput(profile.get_output_port(), builder, 0.02)
force_log = LogVectorOutput(ink.GetOutputPort("normal_force"), builder, 0.02)
simulator = Simulator(builder.Build())
simulator.AdvanceTo(10.0)

# %%
# The force on the board follows the desired one after the tool has landed:

context = simulator.get_context()
time = desired_log.FindLog(context).sample_times()
desired_force = desired_log.FindLog(context).data()[0]
force = force_log.FindLog(context).data()[0]
figure, ax = plt.subplots(figsize=(8, 3.5), layout="constrained")
ax.plot(time, force, color="tab:orange", label="on the board")
ax.plot(time, desired_force, color="k", linestyle="--", label="desired")
ax.set(xlabel="time (s)", ylabel="normal force (N)", ylim=(0, 20))
ax.legend()
plt.show()

error = np.sqrt(np.mean((force - desired_force)[time > 2.0] ** 2))
print(f"force error {error:.1f} N rms")
assert error < 2.5
