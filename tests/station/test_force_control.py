"""Facts about the normal force on a board that is not where the robot thinks it is."""

import numpy as np
import pytest
from arm_loop import Signals
from pydrake.geometry import ProximityProperties, RoleAssign
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import BoardConfig
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.impedance.force_control import ForceControlConfig
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)

pytestmark = pytest.mark.slow

WANTED = 10.0


def wipe(t):
    """Down to the board, then a Lissajous figure of 16 by 24 cm, up to 0.5 m/s."""
    ratio = np.clip(t - 1.0, 0.0, 1.0)
    omega = 2 * np.pi * 0.6
    return np.array(
        [
            0.08 * ratio * np.sin(omega * t),
            0.12 * ratio * np.sin(0.7 * omega * t),
            0.03 * (1 - min(t, 1.0)),
        ]
    )


def press_run(*, enabled, height, friction, tilt=5.0, seconds=4.1, lift=np.inf):
    """Return the normal force and the status of every millisecond."""
    builder = DiagramBuilder()
    board = BoardConfig(
        translation=[0.55, 0.0, 0.10 + height], rpy=[np.radians(tilt), 0.0, 0.0]
    )
    scene = AddBoardScene(builder, Scenario(board=board), start=[0, 0, 0.03])
    plant, graph = scene.plant, scene.scene_graph
    for name in ("eraser", "board"):
        for index in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(name)):
            properties = ProximityProperties(
                graph.model_inspector().GetProximityProperties(index)
            )
            properties.UpdateProperty(
                "material", "coulomb_friction", CoulombFriction(friction, friction)
            )
            graph.AssignRole(
                plant.get_source_id(), index, properties, RoleAssign.kReplace
            )
    controller = builder.AddSystem(
        OperationalSpaceImpedanceController(
            scene.model.plant,
            end_effector=scene.model.tip,
            X_WT=RigidTransform([0.55, 0.0, 0.10]),  # Where the board is thought.
            config=scene.robot.config.complete(
                ImpedanceConfig(force_control=ForceControlConfig(enabled=enabled))
            ),
            q_posture=plant.GetDefaultPositions(scene.robot.arm),
        )
    )

    def position(t):
        return wipe(t) + np.array([0, 0, 0.15 * np.clip((t - lift) / 0.5, 0, 1)])

    signals = {
        "desired_position": lambda t: position(t),
        "desired_velocity": lambda t: (wipe(t + 1e-4) - wipe(t - 1e-4)) / 2e-4,
        "desired_acceleration": lambda t: (
            (wipe(t + 1e-3) - 2 * wipe(t) + wipe(t - 1e-3)) / 1e-6 * (t > 2.01)
        ),
        "feedforward_wrench": lambda t: np.array(
            [0, 0, 0, 0, 0, -WANTED * np.clip((t - 0.7) / 0.3, 0, 1)]
        ),
    }
    source = builder.AddSystem(
        Signals({n: (6 if "wrench" in n else 3, f) for n, f in signals.items()}, 7)
    )
    state = plant.get_state_output_port(scene.robot.arm)
    for system in (source, controller):
        builder.Connect(state, system.GetInputPort("state"))
    for name in signals:
        builder.Connect(source.GetOutputPort(name), controller.GetInputPort(name))
    builder.Connect(
        controller.GetOutputPort("torque"),
        plant.get_actuation_input_port(scene.robot.arm),
    )
    sensor = builder.AddSystem(
        InkBoard(
            plant=plant,
            eraser=scene.robot.tip,
            surface=scene.surface,
            grid=InkGrid(size=(0.5, 0.7), cell=0.1),
            period=1.0,
        )
    )
    for name in ("contact_results", "body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), sensor.GetInputPort(name))
    force = sensor.GetOutputPort("normal_force")
    builder.Connect(force, controller.GetInputPort("normal_force"))
    logs = [
        LogVectorOutput(port, builder, 0.001)
        for port in (force, controller.GetOutputPort("status"))
    ]
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(seconds)
    force, status = (
        log.FindLog(simulator.get_context()).data().T.copy() for log in logs
    )
    return force[:, 0], status


def wiping_force(force):
    """Return the mean while wiping, N, and the fraction of it near what is wanted."""
    force = force[2500:]
    return force.mean(), np.mean(np.abs(force - WANTED) < 2)


@pytest.mark.parametrize("height", [0.01, -0.01])
@pytest.mark.parametrize("friction", [0.2, 0.8])
def test_closed_loop_holds_the_force_on_a_tilted_and_shifted_board(height, friction):
    force, status = press_run(enabled=True, height=height, friction=friction)
    mean, within = wiping_force(force)
    assert mean == pytest.approx(WANTED, rel=0.05)
    assert within > 0.95
    flags = status[2500:, 0].astype(int)
    assert np.all(flags & StatusFlag.FORCE_CONTROL)


@pytest.mark.parametrize("height", [0.01, -0.01])
def test_without_the_closed_loop_the_force_is_off(height):
    force, status = press_run(enabled=False, height=height, friction=0.5)
    _, within = wiping_force(force)
    assert within < 0.8
    assert not np.any(status[:, 0].astype(int) & StatusFlag.FORCE_CONTROL)


def test_the_surface_is_reset_when_the_eraser_is_lifted():
    force, status = press_run(
        enabled=True, height=-0.01, friction=0.5, lift=3.0, seconds=4.5
    )
    assert np.abs(status[2500:3000, 4]).max() > 0.005
    lifted = force < 0.5
    assert lifted[-300:].all()
    assert np.abs(status[-50:, 4]).max() == 0
    assert np.all(status[-300:, 0].astype(int) & StatusFlag.CONTACT_LOST)
