"""Facts about curved boards: contact, ink, posture and reach."""

import functools

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station import MakeStation
from fmp_drake.station import board_scene as scene_module
from fmp_drake.station import skill_motion as skill_motion_module
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.external_forces import SimulatedHand
from fmp_drake.station.models.eraser import AddEraser, FeltForceLimit
from fmp_drake.station.models.whiteboard import AddWhiteboard, cell_of, curved_slab
from fmp_drake.station.reach.board_reach import BoardReach, FollowingBounds
from fmp_drake.station.scenario import LoadScenario, Scenario
from fmp_drake.station.scenario_parts import BoardConfig, BoardMotion, EraserConfig
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.surface.surface import project_all, rotation
from fmp_drake.systems.task_motion import TaskMotion
from fmp_drake.systems.teaching.hand_motion import HandMotion

SHAPES = ("cylinder", "dome", "bowl")
DEPTH = 0.002


def board(shape, **values):
    return BoardConfig(shape=shape, size=[0.4, 0.4], **values)


@pytest.mark.parametrize("shape", SHAPES)
def test_mesh_is_a_closed_slab_that_is_on_the_surface_on_average(shape):
    surface = board(shape, radius=0.3).curvature()
    vertices, normals, faces = curved_slab(surface, (0.4, 0.4), 0.02)
    corners = vertices[faces]
    # Every edge belongs to two faces, once in each direction.
    edges = np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert {tuple(e) for e in edges} == {(b, a) for a, b in edges}
    volume = (
        np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    )
    assert volume == pytest.approx(0.4 * 0.4 * 0.02, rel=0.15)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    # Heights of random points on the triangles above the surface.
    top = corners[np.all(faces < len(vertices) // 2, axis=1)]
    weights = np.random.default_rng(0).dirichlet(np.ones(3), (len(top), 200))
    points = np.einsum("npi,nij->npj", weights, top).reshape(-1, 3)
    heights = project_all(surface, points, np.zeros(2))[:, 2]
    curved_axes = 1 if shape == "cylinder" else 2
    assert 0.5 < np.ptp(heights) / (curved_axes * 0.1 * DEPTH) < 1.01
    assert abs(np.mean(heights)) < 0.05 * np.ptp(heights)


@functools.cache
def tool_round_a_pipe(cell=None, *, speed=-1.0, angle=np.pi + 0.3):
    """Slide a felt round a pipe of 0.15 m, 2 mm deep; return ink, its grid, and forces."""
    radius = 0.15
    config = BoardConfig(
        shape="cylinder", radius=radius, size=[0.3, 2 * np.pi * radius], legs=False
    )
    with pytest.MonkeyPatch.context() as patch:
        if cell is not None:
            patch.setattr(
                "fmp_drake.station.models.whiteboard.cell_of", lambda _: (np.inf, cell)
            )
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlant(
            MultibodyPlantConfig(
                time_step=0.001,
                contact_model="hydroelastic_with_fallback",
                discrete_contact_approximation="lagged",
                use_sampled_output_ports=False,
            ),
            builder,
        )
        whiteboard = AddWhiteboard(plant, config)
    eraser = AddEraser(plant, EraserConfig(friction=0.0))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    surface = plant.GetFrameByName("surface", whiteboard)
    plant.WeldFrames(plant.world_frame(), surface)
    tip = plant.GetFrameByName("eraser_tip", eraser)
    axle = plant.AddFrame(
        FixedOffsetFrame(
            "axle", plant.world_frame(), RigidTransform([0.0, 0.0, -radius]), whiteboard
        )
    )
    X_AE = RigidTransform(
        RotationMatrix.MakeXRotation(np.pi), [0.0, 0.0, radius - DEPTH]
    )
    hub = plant.AddFrame(FixedOffsetFrame("hub", tip, X_AE.inverse(), eraser))
    joint = plant.AddJoint(RevoluteJoint("round", axle, hub, [1.0, 0.0, 0.0]))
    plant.Finalize()
    ink = builder.AddSystem(
        InkBoard(
            plant=plant,
            eraser=tip,
            surface=surface,
            grid=InkGrid(size=tuple(config.size), curvature=config.curvature()),
        )
    )
    for name in ("contact_results", "body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), ink.GetInputPort(name))
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    state = plant.GetMyMutableContextFromRoot(context)
    joint.set_angle(state, angle)
    joint.set_angular_rate(state, speed)
    forces = []
    for k in range(60):
        simulator.AdvanceTo(0.01 * (k + 1))
        port = ink.GetOutputPort("normal_force")
        forces.append(port.Eval(ink.GetMyContextFromRoot(context))[0])
    port = ink.GetOutputPort("ink")
    values = port.Eval(ink.GetMyContextFromRoot(context)).reshape(ink.grid.shape)
    return values, ink.grid, np.array(forces)


def test_pipe_is_wiped_across_its_seam_with_an_even_force():
    ink, grid, forces = tool_round_a_pipe()
    assert np.ptp(forces) < 0.1 * np.mean(forces)
    # From 0.3 rad before the seam to 0.3 rad behind it, and by half the felt.
    rows = np.mean(ink, axis=1)
    wiped_rows = np.abs(grid.y[rows < 0.99])
    seam = np.pi * 0.15
    assert np.max(wiped_rows) == pytest.approx(seam, abs=grid.cell)
    assert np.min(wiped_rows) == pytest.approx(seam - 0.3 * 0.15 - 0.025, abs=0.01)
    # Alike on both sides of the seam, as no cell is wiped twice.
    np.testing.assert_allclose(rows[:5], rows[-5:][::-1], atol=0.03)
    columns = np.abs(grid.x) < 0.05
    assert np.all(ink[:4, columns] < 0.4)
    assert np.all(ink[:, np.abs(grid.x) > 0.07] == 1)


def test_coarse_mesh_makes_a_pipe_a_prism():
    _, _, fine = tool_round_a_pipe()
    _, _, coarse = tool_round_a_pipe(0.1)
    assert np.ptp(coarse) > 5 * np.ptp(fine)


def scene_of(config):
    builder = DiagramBuilder()
    scene = AddBoardScene(builder, Scenario(board=config), start=[0.0, 0.0, 0.05])
    diagram = builder.Build()
    context = scene.plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    return scene, scene.plant.get_contact_results_output_port().Eval(context)


def test_convex_hull_of_a_bowl_has_no_contact(monkeypatch):
    config = BoardConfig(shape="bowl", size=[0.5, 0.5], translation=[0.5, 0.0, 0.1])
    _, contacts = scene_of(config)
    assert contacts.num_point_pair_contacts() == 0
    monkeypatch.setattr(scene_module, "FilterHull", lambda *_: None)
    _, contacts = scene_of(config)
    depths = [
        contacts.point_pair_contact_info(i).point_pair().depth
        for i in range(contacts.num_point_pair_contacts())
    ]
    # The stem stands on an invisible lid.
    assert max(depths) > 0.02


def test_tool_starts_along_the_local_normal():
    scenario = Scenario(board=board("dome", radius=0.3), start=[0.1, -0.1, 0.03])
    scene = AddBoardScene(DiagramBuilder(), scenario, start=scenario.start)
    context = scene.plant.CreateDefaultContext()
    X_BE = scene.X_WB.inverse() @ scene.robot.tip.CalcPoseInWorld(context)
    uvh = project_all(
        scenario.board.curvature(), X_BE.translation()[None], np.zeros(2)
    )[0]
    np.testing.assert_allclose(uvh, scenario.start, atol=1e-5)
    R_BT = rotation(scenario.board.curvature(), *uvh[:2])
    np.testing.assert_allclose(X_BE.rotation().matrix()[:, 2], -R_BT[:, 2], atol=1e-4)


def test_rotation_around_a_pipe_costs_joint_speed():
    path = np.zeros((1, 21, 3))
    path[0, :, 1] = np.linspace(-0.1, 0.1, 21)
    fastest = {}
    for shape in ("plane", "cylinder"):
        scenario = Scenario(board=board(shape, radius=0.3))
        reach = BoardReach(scenario, FollowingBounds())
        motion = reach.follow(
            [scenario.board.assumed_pose()],
            path,
            step=0.05,
            postures=reach.start_posture()[None],
        )
        assert np.max(np.linalg.norm(motion.error, axis=-1)) < 0.01
        fastest[shape] = np.max(np.abs(motion.v))
    # 0.2 m/s on a radius of 0.3 m: the tool turns with 0.67 rad/s.
    assert fastest["cylinder"] > fastest["plane"] + 0.3


def test_felt_has_less_depth_on_a_curved_board():
    eraser = EraserConfig()
    flat = FeltForceLimit(eraser)
    config = board("dome", radius=0.3)
    sagitta = config.curvature().sagitta((0.12, 0.05))
    assert sagitta == pytest.approx((0.06**2 + 0.025**2) / 0.6)
    assert FeltForceLimit(eraser, sagitta=sagitta) == pytest.approx(
        flat * (0.012 - sagitta) / 0.012
    )
    Scenario(board=board("plane")).check()
    scenario = Scenario(board=config)
    scenario.press.force = 40.0
    with pytest.raises(StationError, match="squeezed to its core"):
        scenario.check()


def test_longest_edges_of_a_mesh_follow_the_radius():
    u, v = cell_of(board("cylinder", radius=0.3).curvature())
    assert np.isinf(u)
    assert v**2 / (8 * 0.3) == pytest.approx(0.1 * DEPTH)


class FrameWithoutVelocity(TaskMotion):
    """A moving task frame whose velocity and acceleration are said to be 0."""

    def _calc_desired(self, context, output):
        super()._calc_desired(context, output)
        values = output.get_mutable_value()
        assert [*self.parts.values()][-2:] == [6, 6]
        values[-12:] = 0


def tracking(skill, **values):
    """Return the error along a pipe, m, and the normal force, N, after 2 s."""
    pipe = board("cylinder", radius=0.3, translation=[0.55, 0, 0.2], **values)
    scenario = Scenario(board=pipe)
    scenario.skill.tempo = 0.4
    scenario.impedance.rotational_stiffness = [60.0, 60.0, 60.0]
    scenario.impedance.force_control.enabled = True
    station = MakeStation(scenario, skill)
    simulator = Simulator(station)
    context = simulator.get_context()
    errors, forces = [], []
    for time in np.arange(2.0, 4.0, 0.05):
        simulator.AdvanceTo(time)
        measured, desired, force = (
            station.GetOutputPort(name).Eval(context)
            for name in ("measured_position", "desired_position", "normal_force")
        )
        errors.append(np.linalg.norm((measured - desired)[:2]))
        forces.append(force[0])
    return np.sqrt(np.mean(np.square(errors))), np.array(forces)


def test_pipe_is_followed_with_an_even_force(bundled_skill):
    error, forces = tracking(bundled_skill)
    assert error < 0.005
    assert np.all((forces > 9) & (forces < 11))


def test_pipe_on_a_rail_is_followed_with_an_even_force(bundled_skill):
    # Two moving frames: up to 31 mm/s along the pipe and around it.
    motion = BoardMotion(axis=[1.0, 1.0, 0.0], amplitude=0.05, frequency=0.1)
    error, forces = tracking(bundled_skill, motion=motion)
    assert error < 0.005
    assert np.all((forces > 9) & (forces < 11))


def test_pipe_is_not_followed_by_a_frame_without_its_velocity(
    bundled_skill, monkeypatch
):
    monkeypatch.setattr(skill_motion_module, "TaskMotion", FrameWithoutVelocity)
    error, _ = tracking(bundled_skill)
    assert error > 0.015


@pytest.mark.parametrize("name", ["polish_pipe", "clean_bowl"])
def test_hand_guides_the_tool_along_a_curved_board(name):
    scenario = LoadScenario(name)
    motion = HandMotion.make("polishing", duration=5.0, seed=0)
    station = MakeStation(scenario, SimulatedHand(motion))
    simulator, surface = Simulator(station), scenario.board.curvature()
    motion = motion.slowed(surface)
    plant = station.GetSubsystemByName("plant")
    tip = plant.GetFrameByName("eraser_tip")
    gaps, heights, tilts = [], [], []
    for time in np.arange(1.0, 3.2, 0.05):
        simulator.AdvanceTo(time)
        context = simulator.get_context()
        position = station.GetOutputPort("position").Eval(context)
        X_WE = tip.CalcPoseInWorld(plant.GetMyContextFromRoot(context))
        X_BE = scenario.board.assumed_pose().inverse() @ X_WE
        normal = -X_BE.rotation().matrix()[:, 2]
        gaps.append(np.linalg.norm(position[:2] - motion.at(time)[0]))
        heights.append(position[2])
        tilts.append(normal @ rotation(surface, *position[:2])[:, 2])
    assert np.max(np.abs(heights)) < 0.01
    assert np.max(gaps) < 0.03
    # The tool turns by up to 17 degrees to and fro.
    assert np.degrees(np.arccos(np.min(tilts))) < 6


def test_hand_that_wipes_a_dome_keeps_the_speeds_of_the_joints():
    scenario = LoadScenario("wipe_dome")
    motion = HandMotion.make("wiping", duration=6.0, seed=0)
    station = MakeStation(scenario, SimulatedHand(motion))
    limits = station.GetSubsystemByName("plant").GetVelocityUpperLimits()[:7]
    simulator, fastest = Simulator(station), 0.0
    for time in np.arange(1.0, 5.0, 0.01):
        simulator.AdvanceTo(time)
        state = station.GetOutputPort("state").Eval(simulator.get_context())
        fastest = max(fastest, np.max(np.abs(state[7:]) / limits))
    # As fast as on a flat board it would be 1.26.
    assert fastest < 0.9
