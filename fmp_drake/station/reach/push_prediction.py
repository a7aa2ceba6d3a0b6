"""Prediction of how far scripted pushes lift the eraser off a board."""

import math
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
    push: Disturbance, config: ImpedanceConfig, *, force: float, mass: float
) -> float:
    """Predict how far a push lifts the eraser off the board.

    The eraser is a mass on the spring and the damper along the normal,
    ``m z̈ + D ż + K z = f − F``, above the board at z = 0. The normal force F of the
    controller is that of an approach: up to twice the desired one far from the board.

    Parameters
    ----------
    push : Disturbance
    config : ImpedanceConfig
    force : float
        Desired normal force, N.
    mass : float
        Of `normal_mass`, kg.

    Returns
    -------
    float
        m; zero for a push that the normal force withstands.
    """
    control = values_of(config.force_control)
    stiffness = config.translational_stiffness[2]
    damping = 2 * config.damping_ratio * math.sqrt(stiffness * mass)
    time = z = speed = 0.0
    while time < push.duration or speed > 0:
        total = push.force[2] if time < push.duration else 0.0
        total -= force * approach_factor(control, 0.0, z, -speed)
        speed += _STEP * (total - damping * speed - stiffness * z) / mass
        z += _STEP * speed
        if z < 0:
            z = speed = 0.0
        time += _STEP
    return z


class LiftPrediction(NamedTuple):
    """Lift of the eraser by several pushes.

    Attributes
    ----------
    lift : float
        Greatest height, m.
    push : float
        Force along the normal that lifts the eraser so high, N.
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

    def lifts(force: float) -> list[float]:
        config = scenario.impedance
        return [predict_lift(p, config, force=force, mass=mass) for p in pushes]

    heights = lifts(force)
    low = high = force
    if max(heights) > allowed:
        high = max(push.force[2] for push in pushes)
    while high - low > _PRECISION:
        middle = (low + high) / 2
        low, high = (middle, high) if max(lifts(middle)) > allowed else (low, middle)
    highest = int(np.argmax(heights))
    return LiftPrediction(heights[highest], pushes[highest].force[2], high)
