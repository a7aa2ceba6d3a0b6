"""
The wiping station in Python: move the board, push the arm
==========================================================

A scenario is data. A station is built from it, and its exported ports are its interface. Here the
board is moved and rotated. The skill is expressed in the frame of the board, so it need not be
learned again. A push of 15 N disturbs the arm after 6 s.
"""

# sphinx_gallery_thumbnail_path = '../../models/scenarios/table_top.png'

import matplotlib.pyplot as plt
import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import LoadScenario, MakeWipingStation, models_dir
from fmp_drake.systems import InlinePage

recording = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
skill = FourierMovementPrimitive().fit(recording)

scenario = LoadScenario("table_top")
scenario.board.translation = [0.52, 0.08, 0.14]
scenario.board.rpy = [0.0, -0.10, 0.15]
scenario.press.force = 8.0

# Meshcat is optional. To watch the run, open the page `meshcat.web_url()`, and set the
# simulator's target realtime rate.
meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
station = MakeWipingStation(scenario, skill, start=[0.05, 0.20, 0.10], meshcat=meshcat)
simulator = Simulator(station)
context = simulator.get_mutable_context()

# %%
# An external force
# -----------------
# `applied_spatial_force` is the plant's port for forces on any body.

pushes = station.GetInputPort("applied_spatial_force")
push = ExternallyAppliedSpatialForce()
push.body_index = station.GetSubsystemByName("plant").GetBodyByName("eraser").index()
push.F_Bq_W = SpatialForce(np.zeros(3), np.array([0.0, 15.0, 0.0]))

# %%
# Simulate
# --------

rows = []
meshcat.StartRecording()
simulator.Initialize()
for second in range(9):
    forces = [push] if second == 6 else []
    pushes.FixValue(context, Value[list[ExternallyAppliedSpatialForce]](forces))
    for tenth in range(1, 11):
        simulator.AdvanceTo(second + tenth / 10)
        desired = station.GetOutputPort("desired_position").Eval(context)
        measured = station.GetOutputPort("measured_position").Eval(context)
        force = station.GetOutputPort("normal_force").Eval(context)[0]
        cleaned = station.GetOutputPort("cleaned_fraction").Eval(context)[0]
        error = 1e3 * np.linalg.norm(desired - measured)
        rows.append((context.get_time(), error, force, 100 * cleaned))
    print(
        f"{second + 1:3} s  error {error:5.1f} mm  force {force:5.1f} N"
        f"  cleaned {100 * cleaned:4.1f} %{'  (pushed)' if forces else ''}"
    )

# %%
time, error, force, cleaned = np.array(rows).T
figure, axes = plt.subplots(3, 1, figsize=(8, 6), layout="constrained", sharex=True)
for ax, values, label in zip(
    axes,
    (error, force, cleaned),
    ("tracking error (mm)", "normal force (N)", "cleaned (%)"),
    strict=True,
):
    ax.plot(time, values, color="tab:orange")
    ax.axvspan(6, 7, color="0.9")
    ax.set_ylabel(label)
axes[-1].set_xlabel("time (s)")
plt.show()

# %%
# A page that replays the run in 3D; a notebook shows it here.

meshcat.StopRecording()
meshcat.PublishRecording()
InlinePage(meshcat.StaticHtml())
