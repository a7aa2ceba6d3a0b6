"""Prediction of how far scripted pushes lift the eraser off a board."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fmp_drake.station.reach.tracking_prediction import PredictedMotion
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems import ImpedanceConfig
from fmp_drake.systems.impedance.force_control import approach_factor
from fmp_drake.systems.impedance.records import values_of
from fmp_drake.systems.scripted_disturbances import Disturbance

# Step of the integration, s, and precision of a normal force, N.
_STEP, _PRECISION = 0.002, 0.1


def normal_mass(motion: PredictedMotion) -> float:
    """Return the median effective mass of the eraser along the board's normal, kg."""
    M, J = motion.M[0], motion.J[0]
    mobility = J @ np.linalg.solve(M, J.mT)
    return float(1 / np.median(mobility[:, 5, 5]))


def predict_lift(
    pushes: Sequence[Disturbance], config: ImpedanceConfig, *, force: float, mass: float
) -> float:
    """Predict how far pushes lift the eraser off the board.

    The eraser is a mass on the spring and the damper along the normal,
    ``m z̈ + D ż + K z = f − F``, above the board at z = 0. f is the sum of the pushes at
    that time. The normal force F of the controller is that of an approach: up to twice the
    desired one far from the board.

    Parameters
    ----------
    pushes : sequence of Disturbance
        Each counts once, without its repetitions.
    config : ImpedanceConfig
    force : float
        Desired normal force, N.
    mass : float
        Of `normal_mass`, kg.

    Returns
    -------
    float
        Greatest height, m; zero for pushes that the normal force withstands.
    """
    control = values_of(config.force_control)
    stiffness = config.translational_stiffness[2]
    damping = 2 * config.damping_ratio * math.sqrt(stiffness * mass)
    end = max(push.start + push.duration for push in pushes)
    time = z = speed = highest = 0.0
    while time < end or speed > 0:
        active = _active(pushes, time)
        if not active and z == 0:  # On the board until the next push.
            time = min(push.start for push in pushes if push.start > time)
            continue
        total = sum(active) - force * approach_factor(control, 0.0, z, -speed)
        speed += _STEP * (total - damping * speed - stiffness * z) / mass
        z += _STEP * speed
        if z < 0:
            z = speed = 0.0
        highest = max(highest, z)
        time += _STEP
    return highest


def _active(pushes: Sequence[Disturbance], time: float) -> list[float]:
    """Return the forces along the normal of the pushes at a time, N."""
    return [p.force[2] for p in pushes if p.start <= time < p.start + p.duration]


class LiftPrediction(NamedTuple):
    """Lift of the eraser by several pushes.

    Attributes
    ----------
    lift : float
        Greatest height, m.
    push : float
        Largest sum of the pushes along the normal at one time, N.
    withstanding : float
        Smallest normal force at which no push lifts the eraser higher than allowed, N.
    """

    lift: float
    push: float
    withstanding: float


def predict_lifts(
    scenario: Scenario, motion: PredictedMotion, *, force: float, allowed: float
) -> LiftPrediction:
    """Predict how far a scenario's pushes lift the eraser, and what force withstands them.

    Parameters
    ----------
    scenario : Scenario
    motion : PredictedMotion
    force : float
        Desired normal force, N.
    allowed : float
        Allowed height, m.
    """
    pushes = [push for push in scenario.disturbances if push.kind == "push"]
    if not pushes:
        return LiftPrediction(0.0, 0.0, force)
    mass = normal_mass(motion)

    def lift(force: float) -> float:
        return predict_lift(pushes, scenario.impedance, force=force, mass=mass)

    highest, low, high = lift(force), force, force
    changes = [p.start + seconds for p in pushes for seconds in (0.0, p.duration)]
    largest = max(sum(_active(pushes, time)) for time in changes)
    if highest > allowed:
        high = largest
    while high - low > _PRECISION:
        middle = (low + high) / 2
        low, high = (middle, high) if lift(middle) > allowed else (low, middle)
    return LiftPrediction(highest, largest, high)
