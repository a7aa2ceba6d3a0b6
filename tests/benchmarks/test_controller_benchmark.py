"""Time of one update of the controller, and its fraction of the whole step.

No limit is asserted: the figures depend on the machine. Save them by `make bench`.
"""

import numpy as np
import pytest
from arm_loop import Q_START, X_WT_TILTED, ArmLoop, make_arm, pose_in_task
from pydrake.systems.analysis import Simulator

from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)


@pytest.fixture(scope="module")
def controller():
    plant = make_arm()
    config = ImpedanceConfig(orientation=[0.0, 0.0, 0.0])
    X_TE = pose_in_task(plant, Q_START, X_WT_TILTED)
    config.orientation = list(X_TE.rotation().ToRollPitchYaw().vector())
    return OperationalSpaceImpedanceController(
        plant,
        end_effector=plant.GetFrameByName("eraser_tip"),
        X_WT=X_WT_TILTED,
        config=config,
        q_posture=Q_START,
    )


@pytest.fixture
def context(controller):
    context = controller.CreateDefaultContext()
    p = pose_in_task(make_arm(), Q_START, X_WT_TILTED).translation()
    for name, value in {
        "desired_position": p,
        "desired_velocity": np.zeros(3),
        "desired_acceleration": np.zeros(3),
        "desired_normal_force": np.zeros(1),
    }.items():
        controller.GetInputPort(name).FixValue(context, value)
    return context


def test_one_update_of_the_controller(benchmark, controller, context):
    """With the features that are on by default, at a state that changes."""
    rng = np.random.default_rng(0)
    start = np.r_[Q_START, np.zeros(7)]

    def another_state():
        state = start + 1e-4 * rng.normal(size=14)
        controller.GetInputPort("state").FixValue(context, state)

    values = benchmark.pedantic(
        lambda: controller.EvalUniquePeriodicDiscreteUpdate(context),
        setup=another_state,
        rounds=2000,
        warmup_rounds=200,
    )
    assert np.isfinite(values.value(0)).all()


def test_one_step_of_arm_and_controller(benchmark):
    """A millisecond of the arm in free air with nothing logged; its share is one
    update's time by this."""
    loop = ArmLoop(log=())
    simulator = Simulator(loop.diagram)
    plant_context = loop.plant.GetMyMutableContextFromRoot(
        simulator.get_mutable_context()
    )
    loop.plant.SetPositions(plant_context, Q_START)
    simulator.Initialize()
    milliseconds = iter(range(1, 10**6))

    def step():
        simulator.AdvanceTo(0.001 * next(milliseconds))

    benchmark.pedantic(step, rounds=1000, warmup_rounds=100)
    assert simulator.get_context().get_time() > 1
