"""Push the arm of a scenario at its eraser, and report its reaction.

    python station_pushes.py table_top --force 34 80 --direction=0,0,-1 --direction=1,1,-1

One second with each force in each direction of B (by default 20, 40 and 80 N along the 6
axes and the 8 diagonals), from one and the same instant of the run: the simulation
begins once, and each push goes on from a copy of its Context. For each push, as a table or
as JSON with `--json`: the deepest hard point below the surface, the limits of the joints that
were broken (the largest fraction of each that was used), the seconds from the release until the normal
force is within 5 N of the wanted one, and until the eraser is within the 99 % tube around
its target in the plane of the board, for good (None: not within 6 s); and all status
flags that were seen.
"""

import argparse
import json
import sys
from copy import copy
from itertools import product

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from scipy.stats import chi2

from fmp_drake.skills import scenario_skill
from fmp_drake.station import LoadScenario, MakeWipingStation
from fmp_drake.systems import ImpedanceStatus, StatusFlag

# In ticks of the controller. The times are their multiples, as the events' are.
BEGIN, PUSH, WATCHED, SLOW = 4000, 1000, 6000, 10
TICK = 0.001
TUBE = float(chi2.ppf(0.99, df=2))
AXES = [
    np.array(d) for d in product((-1, 0, 1), repeat=3) if sum(map(abs, d)) in (1, 3)
]


class Pushed:
    """A station that is pushed from one instant on, again and again."""

    def __init__(self, name):
        self.scenario = LoadScenario(name)
        skill, _, _ = scenario_skill(self.scenario)
        self.scenario.disturbances = []
        self.station = MakeWipingStation(self.scenario, skill)
        self.plant = self.station.GetSubsystemByName("plant")
        simulator = self._simulator(self.station.CreateDefaultContext())
        simulator.Initialize()
        simulator.AdvanceTo(BEGIN * TICK)
        self.start = simulator.get_context().Clone()

    def _simulator(self, context):
        simulator = Simulator(self.station, context)
        if self.scenario.plant.time_step == 0:
            config = copy(self.scenario.simulator)
            config.start_time = context.get_time()  # It would begin again at 0.
            ApplySimulatorConfig(config, simulator)
        return simulator

    def _force(self, force_B, context):
        at = self.plant.GetMyContextFromRoot(context)
        board = self.plant.GetFrameByName("surface").CalcRotationMatrixInWorld(at)
        force = ExternallyAppliedSpatialForce()
        tip = self.plant.GetFrameByName("eraser_tip")
        force.body_index = tip.body().index()
        force.p_BoBq_B = tip.GetFixedPoseInBodyFrame().translation()
        force.F_Bq_W = SpatialForce(np.zeros(3), board @ np.array(force_B, dtype=float))
        return [force] if np.any(force_B) else []

    def push(self, force_B):
        """Return what a push of 1 s does, as a dict."""
        context = self.start.Clone()
        port = self.station.GetInputPort("applied_spatial_force")
        port.FixValue(context, self._force(force_B, context))
        simulator = self._simulator(context)
        simulator.Initialize()
        broken, flags, depth = {}, StatusFlag(0), 0.0
        last = self._value("torque", context)
        times, pressed, followed = [], [], []
        for tick in range(1, PUSH + WATCHED + 1):
            if tick == PUSH + 1:
                port.FixValue(simulator.get_mutable_context(), [])
            simulator.AdvanceTo((BEGIN + tick) * TICK)
            context = simulator.get_context()
            torque = self._value("torque", context)
            for name, load in self._loads(torque, last, context).items():
                # What is not a number breaks a limit as well.
                if not load <= max(1.0, broken.get(name, 0.0)):
                    broken[name] = round(float(load), 3)
            last = torque
            if tick % SLOW == 0:
                depth = max(depth, self._value("penetration", context)[0])
                status = ImpedanceStatus.from_vector(self._value("status", context))
                flags |= status.flags
                times.append((tick - PUSH) * TICK)
                wanted = self.scenario.press.force
                force = self._value("normal_force", context)[0]
                pressed.append(abs(force - wanted) < 5)
                followed.append(self._in_tube(context))
        times = np.array(times)
        return {
            "force": float(np.linalg.norm(force_B)),
            "direction": np.sign(force_B).astype(int).tolist(),
            "penetration_mm": round(1e3 * float(depth), 2),
            "broken": broken,
            "press_back_s": _back(times, np.array(pressed)),
            "tube_back_s": _back(times, np.array(followed)),
            "status": str(flags.name or "0").replace("|", " "),
        }

    def _value(self, name, context):
        return np.array(self.station.GetOutputPort(name).Eval(context))

    def _loads(self, torque, last, context):
        """Return how much of each limit is used; a position out of its range is 2."""
        plant = self.plant
        q, v = np.split(self._value("state", context), 2)
        low, high = (
            plant.GetPositionLowerLimits()[:7],
            plant.GetPositionUpperLimits()[:7],
        )
        actuation = self._value("actuation", context)
        return {
            "position": 2.0 if np.any((q < low) | (q > high)) else 0.0,
            "speed": np.max(np.abs(v) / plant.GetVelocityUpperLimits()[:7]),
            "torque": np.max(np.abs(actuation) / plant.GetEffortUpperLimits()[:7]),
            "torque rate": np.max(np.abs(torque - last)) / (1000 * TICK),
        }

    def _in_tube(self, context):
        away = self._value("measured_position", context)
        away -= self._value("desired_position", context)
        covariance = self._value("covariance", context).reshape(3, 3)[:2, :2]
        return away[:2] @ np.linalg.solve(covariance, away[:2]) < TUBE


def _back(times, good):
    """Return the seconds after the release from which on all is good, or None."""
    bad = np.flatnonzero(~good & (times > 0))
    if not bad.size:
        return 0.0
    return None if bad[-1] == len(times) - 1 else round(float(times[bad[-1] + 1]), 2)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario")
    parser.add_argument("--force", type=float, nargs="+", default=[20.0, 40.0, 80.0])
    parser.add_argument("--direction", action="append", help="of B: =0,0,-1")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    directions = AXES
    if options.direction:
        directions = [np.array(d.split(","), dtype=float) for d in options.direction]
    pushed = Pushed(options.scenario)
    rows = []
    for force, direction in product(options.force, directions):
        row = pushed.push(force * direction / np.linalg.norm(direction))
        rows.append(row)
        if not options.json:
            columns = [f"{row['force']:.0f} N", *map(str, list(row.values())[1:])]
            sys.stdout.write(" | ".join(columns) + "\n")
            sys.stdout.flush()
    if options.json:
        json.dump(rows, sys.stdout)


if __name__ == "__main__":
    main()
