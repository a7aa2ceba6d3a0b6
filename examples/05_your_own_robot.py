"""
Your own robot arm
==================

The primitive and the controller work with any arm. Here they move an arm of six joints,
whose URDF this script writes; replace it with yours. Each joint needs limits and an actuator, each
link a mass and an inertia. The controller reads everything else from the model.
"""

import matplotlib.pyplot as plt
import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, LogVectorOutput

from fmp_drake import Demonstration, FourierMovementPrimitive
from fmp_drake.station import SolvePosture, models_dir
from fmp_drake.systems import (
    FourierPrimitiveSystem,
    ImpedanceConfig,
    OperationalSpaceImpedanceController,
)

# For each link the axis of its joint, its length, m, and its mass, kg.
LINKS = [
    ("0 0 1", 0.30, 5.0),
    ("0 1 0", 0.40, 4.0),
    ("0 1 0", 0.35, 3.0),
    ("0 0 1", 0.10, 1.5),
    ("0 1 0", 0.10, 1.0),
    ("0 0 1", 0.08, 0.5),
]


def write_urdf():
    """Return an upright chain of slender links, with a motor at the lower end of each."""
    text = '<robot name="own_arm"><link name="base"/>'
    parent, height = "base", 0.0
    for i, (axis, length, mass) in enumerate(LINKS):
        inertia = mass * length**2 / 12 + 0.01
        text += f"""
        <link name="link{i}"><inertial>
          <origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>
          <inertia ixx="{inertia}" iyy="{inertia}" izz="0.01" ixy="0" ixz="0" iyz="0"/>
        </inertial></link>
        <joint name="joint{i}" type="revolute">
          <parent link="{parent}"/><child link="link{i}"/>
          <origin xyz="0 0 {height}"/><axis xyz="{axis}"/>
          <limit lower="-2.9" upper="2.9" velocity="2.5" effort="{80 if i < 3 else 15}"/>
        </joint>
        <transmission name="motor{i}"><type>SimpleTransmission</type>
          <joint name="joint{i}"/><actuator name="motor{i}"/>
        </transmission>"""
        parent, height = f"link{i}", length
    return f"{text}</robot>"


def add_arm(plant):
    """Add the arm, welded to the world."""
    (arm,) = Parser(plant).AddModelsFromString(write_urdf(), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    return arm


# %%
# There are two plants of the same arm. The simulated one has no gravity, because a real arm
# compensates for it. The other one is the model of the controller.

builder = DiagramBuilder()
plant = builder.AddSystem(MultibodyPlant(time_step=0.001))
plant.set_gravity_enabled(add_arm(plant), False)
plant.Finalize()
model = MultibodyPlant(time_step=0.0)
add_arm(model)
model.Finalize()
tip = model.GetFrameByName("link5")

# %%
# The movement is an 8 on an inclined plane in front of the arm; the last link points into the
# plane.

X_WT = RigidTransform(RotationMatrix.MakeYRotation(-0.3), [0.5, 0.0, 0.25])
demonstration = Demonstration.load(models_dir() / "demonstrations" / "eight.npz")
skill = FourierMovementPrimitive().fit(demonstration)
start = skill.paths_[0][0]
config = ImpedanceConfig(orientation=[0.0, np.pi, 0.0])
controller = builder.AddSystem(
    OperationalSpaceImpedanceController(
        model, end_effector=tip, X_WT=X_WT, config=config
    )
)
posture = SolvePosture(
    model,
    frame=tip,
    X_WE=X_WT @ RigidTransform(RotationMatrix(config.desired_rotation()), start),
    q_preferred=[0.0, 0.2, 1.6, 0.0, 1.3, 0.0],
)
plant.SetDefaultPositions(posture)

# %%
# The connections are the same for any robot.

primitive = builder.AddSystem(FourierPrimitiveSystem(skill, sample=False))
motion = builder.AddSystem(Demultiplexer([3, 3, 3]))
builder.Connect(primitive.GetOutputPort("motion"), motion.get_input_port())
for i, order in enumerate(("position", "velocity", "acceleration")):
    port = controller.GetInputPort(f"desired_{order}")
    builder.Connect(motion.get_output_port(i), port)
measured = controller.GetOutputPort("measured_position")
builder.Connect(measured, primitive.GetInputPort("measured_position"))
builder.Connect(plant.get_state_output_port(), controller.GetInputPort("state"))
torque = controller.GetOutputPort("torque")
builder.Connect(torque, plant.get_actuation_input_port())
logs = [
    LogVectorOutput(port, builder, 0.01)
    for port in (measured, motion.get_output_port(0))
]

# %%
# Simulate
# --------

simulator = Simulator(builder.Build())
simulator.AdvanceTo(8.0)
path, desired_path = (log.FindLog(simulator.get_context()).data() for log in logs)
error = np.linalg.norm(path - desired_path, axis=0)
print(f"tracking error of six joints: {1e3 * np.sqrt(np.mean(error**2)):.1f} mm rms")

figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
axes.plot(*desired_path[:2], color="tab:blue", label="desired")
axes.plot(*path[:2], "--", color="tab:orange", label="measured")
axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
figure.legend(loc="outside upper center", ncols=2)
plt.show()
