"""Build the whiteboard station in Python, change it, and run it.

    python examples/03_wiping_station.py              # with a page in the browser
    python examples/03_wiping_station.py --headless

The board is moved and turned here; the skill lives in the frame of the board, so it comes
along without new learning. A push of 15 N disturbs the arm after 6 s.
"""

import argparse

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import LoadScenario, MakeWipingStation, models_dir


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--headless", action="store_true")
    parser.add_argument("--duration", type=float, default=12.0)
    arguments = parser.parse_args()

    recording = models_dir() / "demonstrations" / "wiping.npz"
    skill = FourierMovementPrimitive().fit(Demonstration.load(recording))

    scenario = LoadScenario("table_top")
    scenario.board.translation = [0.52, 0.08, 0.14]
    scenario.board.rpy = [0.0, -0.10, 0.15]
    scenario.press.force = 8.0

    meshcat = None if arguments.headless else Meshcat(MeshcatParams(host="localhost"))
    station = MakeWipingStation(
        scenario, skill, start=[0.05, 0.20, 0.10], sample=True, seed=1, meshcat=meshcat
    )
    simulator = Simulator(station)
    simulator.set_target_realtime_rate(0.0 if arguments.headless else 1.0)
    context = simulator.get_mutable_context()

    # The station's exported ports are its interface.
    pushes = station.GetInputPort("applied_spatial_force")
    plant = station.GetSubsystemByName("plant")
    push = ExternallyAppliedSpatialForce()
    push.body_index = plant.GetBodyByName("eraser").index()
    push.F_Bq_W = SpatialForce(np.zeros(3), np.array([0.0, 15.0, 0.0]))

    simulator.Initialize()
    while context.get_time() < arguments.duration:
        now = context.get_time()
        pushed = 6.0 <= now < 7.0
        forces = [push] if pushed else []
        pushes.FixValue(context, Value[list[ExternallyAppliedSpatialForce]](forces))
        simulator.AdvanceTo(min(now + 1.0, arguments.duration))
        desired = station.GetOutputPort("desired_position").Eval(context)
        measured = station.GetOutputPort("measured_position").Eval(context)
        force = station.GetOutputPort("normal_force").Eval(context)[0]
        cleaned = station.GetOutputPort("cleaned_fraction").Eval(context)[0]
        print(
            f"{context.get_time():5.1f} s  off the path "
            f"{1e3 * np.linalg.norm(desired - measured):5.1f} mm  pressing {force:5.1f} N"
            f"  cleaned {100 * cleaned:4.1f} %{'  (pushed)' if pushed else ''}"
        )


if __name__ == "__main__":
    main()
