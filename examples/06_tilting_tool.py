"""
Tilt the tool while it moves, with a stiffness that changes
===========================================================

The impedance controller follows your own signals: `desired_orientation` and its derivatives
rotate the tool, `stiffness` makes the arm softer or stiffer. Without the desired angular velocity
the damping would cause a lag of 10 degrees.
"""

# sphinx_gallery_thumbnail_path = '../../models/scenarios/tilted.png'

import matplotlib.pyplot as plt
import numpy as np
from pydrake.symbolic import Expression, Variable, cos, sin
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, SymbolicVectorSystem

from fmp_drake.station import AddArmController, AddBoardScene, LoadScenario

HEIGHT = 0.15  # Height of the path over the board, m.

scenario = LoadScenario("table_top")
builder = DiagramBuilder()
scene = AddBoardScene(builder, scenario, start=[0.0, 0.0, HEIGHT])
controller = AddArmController(builder, scene, scenario.impedance)

# %%
# All signals are in the frame of the board. At the start the felt faces the board; then the
# tool swings about y while the arm moves back and forth along y.
t = Variable("t")
path = [Expression(0), 0.08 * (1 - cos(1.5 * t)), Expression(HEIGHT)]
velocity = [component.Differentiate(t) for component in path]
angle = 0.25 * (1 - cos(2.0 * t))  # rad
rate = angle.Differentiate(t)
spring = 900 + 600 * cos(t)  # N/m
signals = {
    "desired_position": path,
    "desired_velocity": velocity,
    "desired_acceleration": [component.Differentiate(t) for component in velocity],
    "desired_orientation": [0, cos(angle / 2), 0, -sin(angle / 2)],  # w, x, y, z
    "desired_angular_velocity": [0, rate, 0],
    "desired_angular_acceleration": [0, rate.Differentiate(t), 0],
    "stiffness": np.diag([30, 30, 30, spring, spring, spring]).ravel(),
}
for port, output in signals.items():
    expressions = [Expression() + component for component in output]
    source = builder.AddSystem(
        SymbolicVectorSystem(
            time=t, state=[], input=[], dynamics=[], output=expressions
        )
    )
    builder.Connect(source.get_output_port(), controller.GetInputPort(port))
log = LogVectorOutput(controller.GetOutputPort("tracking_error"), builder, 0.01)

# %%
# Simulate
# --------

simulator = Simulator(builder.Build())
simulator.AdvanceTo(6.0)
error = log.FindLog(simulator.get_context()).data()
angle_error = np.degrees(np.linalg.norm(error[:3], axis=0))
position_error = 1e3 * np.linalg.norm(error[3:], axis=0)
print(f"the tool tilts by up to {np.degrees(0.5):.0f} degrees")
print(
    f"the error is at most {angle_error.max():.1f} degrees and {position_error.max():.1f} mm"
)

figure, axes = plt.subplots(2, 1, figsize=(8, 5), layout="constrained", sharex=True)
time = log.FindLog(simulator.get_context()).sample_times()
for ax, values, label in zip(
    axes,
    (angle_error, position_error),
    ("orientation error (degrees)", "position error (mm)"),
    strict=True,
):
    ax.plot(time, values, color="tab:orange")
    ax.set_ylabel(label)
axes[-1].set_xlabel("time (s)")
plt.show()
