"""Facts about the models: the Panda's dynamics, the eraser's and board's contact."""

import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import (
    PrismaticJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
    default_model_instance,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station.models import model_files
from fmp_drake.station.models.eraser import AddEraser
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.models.whiteboard import AddWhiteboard
from fmp_drake.station.robots.robot import AddRobot, LoadRobot
from fmp_drake.station.scenario_parts import BoardConfig, EraserConfig

START = np.array([0, -math.pi / 4, 0, -3 * math.pi / 4, 0, math.pi / 2, math.pi / 4])
REFLECTED_INERTIA = np.array([0.605721456] * 2 + [0.462474144] * 2 + [0.205544064] * 3)


def _AddModel(plant: MultibodyPlant, path: str) -> None:
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(models_dir() / "package.xml"))
    parser.AddModels(url=f"package://fmp_drake/{path}")


@pytest.fixture(scope="module")
def arm() -> MultibodyPlant:
    """Return the arm alone, welded to the world, at gravity 9.81 m/s^2."""
    plant = MultibodyPlant(1e-3)
    _AddModel(plant, "panda/panda.urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("panda_link0"))
    plant.Finalize()
    return plant


@pytest.fixture(scope="module")
def arm_with_eraser() -> MultibodyPlant:
    plant = MultibodyPlant(1e-3)
    AddRobot(plant, LoadRobot("panda"))
    plant.Finalize()
    return plant


def _PoseAt(plant: MultibodyPlant, frame: str, q: np.ndarray) -> RigidTransform:
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    return plant.GetFrameByName(frame).CalcPoseInWorld(context)


# Finding the files.


def test_models_are_beside_the_package_in_a_checkout():
    assert (models_dir() / "panda" / "panda.urdf").is_file()


def _Pretend(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = folder / "fmp_drake" / "station" / "models" / "model_files.py"
    monkeypatch.setattr(model_files, "__file__", str(module))


def test_models_inside_the_package_win_as_in_a_wheel(tmp_path, monkeypatch):
    source = models_dir() / "package.xml"
    for folder in (tmp_path / "models", tmp_path / "fmp_drake" / "models"):
        folder.mkdir(parents=True)
        shutil.copy(source, folder)
    _Pretend(tmp_path, monkeypatch)
    assert models_dir() == tmp_path / "fmp_drake" / "models"


def test_missing_models_are_an_error_that_names_both_places(tmp_path, monkeypatch):
    (tmp_path / "models").mkdir()  # A folder of that name, but not ours.
    _Pretend(tmp_path, monkeypatch)
    with pytest.raises(StationError, match=r"package\.xml") as caught:
        models_dir()
    assert str(tmp_path / "models") in str(caught.value)
    assert str(tmp_path / "fmp_drake" / "models") in str(caught.value)


def test_no_model_file_names_an_absolute_path_or_a_mesh_of_others():
    for file in models_dir().rglob("*.*"):
        if file.suffix in (".urdf", ".sdf", ".xml"):
            text = file.read_text()
            assert "file://" not in text
            for mesh in re.findall(r'<mesh filename="([^"]*)"', text):
                assert mesh.startswith("package://fmp_drake/")
                assert (
                    models_dir() / mesh.removeprefix("package://fmp_drake/")
                ).exists()


# The arm. The numbers are Franka's and Gaz et al.'s; see panda.urdf for the sources.


def test_the_arm_has_seven_joints_and_seven_motors_in_order(arm):
    names = [f"panda_joint{i}" for i in range(1, 8)]
    panda = arm.GetModelInstanceByName("panda")
    assert arm.num_positions() == 7
    assert [
        arm.get_joint(i).name() for i in arm.GetActuatedJointIndices(panda)
    ] == names
    np.testing.assert_array_equal(arm.MakeActuationMatrix(), np.eye(7))


def test_flange_pose_at_zero(arm):
    X_WF = _PoseAt(arm, "panda_link8", np.zeros(7))
    np.testing.assert_allclose(X_WF.translation(), [0.088, 0, 0.926], atol=1e-12)
    np.testing.assert_allclose(
        X_WF.rotation().matrix(), np.diag([1, -1, -1]), atol=1e-12
    )


def test_flange_pose_at_the_start_posture(arm):
    X_WF = _PoseAt(arm, "panda_link8", START)
    np.testing.assert_allclose(
        X_WF.translation(), [0.306890567, 0, 0.590282052], atol=1e-9
    )
    c = math.sqrt(0.5)
    np.testing.assert_allclose(
        X_WF.rotation().matrix(), [[c, -c, 0], [-c, -c, 0], [0, 0, -1]], atol=1e-12
    )


def test_limits_are_those_of_the_panda(arm):
    upper = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    lower = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    speed = np.array([2.175] * 4 + [2.61] * 3)
    acceleration = np.array([15, 7.5, 10, 12.5, 15, 20, 20])
    effort = np.array([87.0] * 4 + [12.0] * 3)
    np.testing.assert_array_equal(arm.GetPositionUpperLimits(), upper)
    np.testing.assert_array_equal(arm.GetPositionLowerLimits(), lower)
    np.testing.assert_array_equal(arm.GetVelocityUpperLimits(), speed)
    np.testing.assert_array_equal(arm.GetVelocityLowerLimits(), -speed)
    np.testing.assert_array_equal(arm.GetAccelerationUpperLimits(), acceleration)
    np.testing.assert_array_equal(arm.GetAccelerationLowerLimits(), -acceleration)
    np.testing.assert_array_equal(arm.GetEffortUpperLimits(), effort)
    np.testing.assert_array_equal(arm.GetEffortLowerLimits(), -effort)


def test_the_start_posture_is_within_the_limits(arm):
    assert np.all(arm.GetPositionUpperLimits() > START)
    assert np.all(arm.GetPositionLowerLimits() < START)


def test_masses_add_up(arm):
    total = arm.CalcTotalMass(arm.CreateDefaultContext())
    base = arm.GetBodyByName("panda_link0").default_mass()
    assert total == pytest.approx(16.691901, abs=1e-9)
    assert total - base == pytest.approx(16.062132, abs=1e-9)


def test_every_inertia_is_physically_valid(arm_with_eraser):
    names = [f"panda_link{i}" for i in range(8)] + ["eraser"]
    for name in names:
        body = arm_with_eraser.GetBodyByName(name)
        assert isinstance(body, RigidBody)
        assert body.default_mass() > 0
        assert body.default_spatial_inertia().IsPhysicallyValid()


def test_mass_matrix_is_the_identified_one_plus_the_rotors(arm):
    context = arm.CreateDefaultContext()
    arm.SetPositions(context, START)
    identified = [0.4612, 1.4450, 0.8789, 0.7887, 0.0279, 0.0326, 0.0049]
    M = arm.CalcMassMatrix(context)
    np.testing.assert_allclose(np.diag(M), identified + REFLECTED_INERTIA, atol=6e-5)
    assert np.linalg.eigvalsh(M).min() > 0


def test_gravity_torques_are_the_identified_ones(arm):
    context = arm.CreateDefaultContext()
    arm.SetPositions(context, START)
    np.testing.assert_allclose(
        -arm.CalcGravityGeneralizedForces(context),
        [0.0, -1.771, -0.644, 18.574, 0.634, 1.694, 0.0],
        atol=6e-4,
    )


def test_joint_damping_is_the_identified_viscous_friction(arm):
    damping = [
        arm.GetJointByName(f"panda_joint{i}").default_damping_vector()[0]
        for i in range(1, 8)
    ]
    assert damping == [0.0665, 0.1987, 0.0399, 0.2257, 0.1023, 0.0, 0.0638]


# The eraser.


def test_eraser_faces_the_table_at_the_start_posture(arm_with_eraser):
    X_WE = _PoseAt(arm_with_eraser, "eraser_tip", START)
    np.testing.assert_allclose(
        X_WE.rotation().matrix(), np.diag([1, -1, -1]), atol=1e-12
    )
    np.testing.assert_allclose(
        X_WE.translation(), [0.306890567, 0, 0.490282052], atol=1e-9
    )


def test_adding_returns_the_two_instances_and_no_freedom_but_the_arm():
    plant = MultibodyPlant(1e-3)
    robot = AddRobot(plant, LoadRobot("panda"))
    panda, eraser = robot.arm, robot.tool
    plant.Finalize()
    assert plant.GetModelInstanceName(panda) == "panda"
    assert plant.GetModelInstanceName(eraser) == "eraser"
    assert plant.num_positions(panda) == plant.num_positions() == 7
    assert plant.num_positions(eraser) == 0


def test_eraser_inertia_is_that_of_its_four_solids(arm_with_eraser):
    parts = [
        (2700 * math.pi * 0.0315**2 * 0.008, 0.004, (0.0315, 0.008)),
        (2700 * math.pi * 0.012**2 * 0.042, 0.029, (0.012, 0.042)),
        (700 * 0.126 * 0.056 * 0.020, 0.060, (0.126, 0.056, 0.020)),
        (200 * 0.120 * 0.050 * 0.030, 0.085, (0.120, 0.050, 0.030)),
    ]
    total = SpatialInertia.Zero()
    for mass, z, size in parts:
        if len(size) == 2:
            unit = UnitInertia.SolidCylinder(*size, unit_vector=[0, 0, 1])
        else:
            unit = UnitInertia.SolidBox(*size)
        solid = SpatialInertia(mass, np.zeros(3), unit)
        total += solid.Shift(np.array([0, 0, -z]))
    actual = arm_with_eraser.GetBodyByName("eraser").default_spatial_inertia()
    np.testing.assert_allclose(
        actual.CopyToFullMatrix6(), total.CopyToFullMatrix6(), rtol=1e-5, atol=1e-9
    )
    assert actual.get_mass() == pytest.approx(0.25, abs=0.01)


# Contact.


def test_eraser_and_board_are_compliant_and_the_arm_is_not():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), builder)
    AddRobot(plant, LoadRobot("panda"))
    AddWhiteboard(plant, BoardConfig())
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    touching = inspector.GetAllGeometryIds(Role.kProximity)
    compliant = {"felt", "core", "handle", "slab", *(f"bar_{i}" for i in range(1, 5))}
    names = {inspector.GetName(g).split("::")[1] for g in touching}
    links = {f"link{i}_1" for i in range(1, 8)}
    assert {*compliant, "stem", "plate", *links} <= names
    for g in touching:
        properties = inspector.GetProximityProperties(g)
        name = inspector.GetName(g).split("::")[1]
        hydroelastic = properties.HasProperty("hydroelastic", "hydroelastic_modulus")
        assert hydroelastic == (name in compliant)
        if not hydroelastic:
            continue
        friction = properties.GetProperty("material", "coulomb_friction")
        assert friction.static_friction() == friction.dynamic_friction() == 0.5


def test_the_board_is_half_a_metre_by_seven_tenths_with_its_surface_on_top():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), builder)
    AddWhiteboard(plant, BoardConfig())
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("surface"))
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    (slab,) = (
        g
        for g in inspector.GetAllGeometryIds(Role.kProximity)
        if inspector.GetName(g) == "whiteboard::slab"
    )
    hull = inspector.GetShape(slab).GetConvexHull()
    corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    assert inspector.GetPoseInFrame(slab).IsExactlyIdentity()
    np.testing.assert_array_equal(corners.min(axis=0), [-0.25, -0.35, -0.02])
    np.testing.assert_array_equal(corners.max(axis=0), [0.25, 0.35, 0.0])


class _Slide:
    """The eraser on a slide along x and z, pressed by 10 N, dragged at `speed`."""

    def __init__(self, *, speed: float, damping: float = 60.0) -> None:
        builder = DiagramBuilder()
        self.plant, _ = AddMultibodyPlant(
            MultibodyPlantConfig(
                time_step=1e-3, discrete_contact_approximation="lagged"
            ),
            builder,
        )
        plant = self.plant
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        AddEraser(plant, EraserConfig())
        AddWhiteboard(plant, BoardConfig(legs=False))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("surface"))
        instance = default_model_instance()
        sled, ram = (
            plant.AddRigidBody(
                name, instance, SpatialInertia.SolidSphereWithMass(mass, 0.02)
            )
            for name, mass in (("sled", 0.5), ("ram", 2.5))
        )
        plant.AddJoint(
            PrismaticJoint("x", plant.world_frame(), sled.body_frame(), [1, 0, 0])
        )
        plant.AddJoint(
            PrismaticJoint("z", sled.body_frame(), ram.body_frame(), [0, 0, 1])
        )
        plant.WeldFrames(
            ram.body_frame(),
            plant.GetFrameByName("eraser_tip"),
            RigidTransform(RotationMatrix.MakeXRotation(math.pi)),
        )
        plant.Finalize()
        self.simulator = Simulator(builder.Build())
        self.context = plant.GetMyMutableContextFromRoot(
            self.simulator.get_mutable_context()
        )
        plant.SetVelocities(self.context, [speed, 0])
        self.speed = speed
        self.damping = damping

    def Step(self) -> tuple[np.ndarray, float]:
        """Advance 1 ms; return the force on the board (N, in B) and the depth (m)."""
        velocity = self.plant.GetVelocities(self.context)
        self.plant.get_applied_generalized_force_input_port().FixValue(
            self.context,
            [2000 * (self.speed - velocity[0]), -10 - self.damping * velocity[1]],
        )
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + 1e-3)
        results = self.plant.get_contact_results_output_port().Eval(self.context)
        assert results.num_point_pair_contacts() == 0
        depth = -self.plant.GetPositions(self.context)[1]
        if results.num_hydroelastic_contacts() == 0:
            return np.zeros(3), depth
        info = results.hydroelastic_contact_info(0)
        force = info.F_Ac_W().translational()
        return force if force[2] < 0 else -force, depth


def test_ten_newtons_squeeze_the_felt_by_two_millimetres():
    slide = _Slide(speed=0.0)
    for _ in range(1000):
        force, depth = slide.Step()
    np.testing.assert_allclose(force, [0, 0, -10], atol=0.02)
    # The modulus would give 2.0 mm if the pressure did not fade at the edges.
    assert depth == pytest.approx(2.13e-3, abs=0.02e-3)


def test_wiping_presses_without_ripple_and_rubs_with_the_friction_coefficient():
    slide = _Slide(speed=0.1)
    for _ in range(1000):
        slide.Step()
    forces = np.array([slide.Step()[0] for _ in range(300)])
    assert np.ptp(forces[:, 2]) < 0.01
    np.testing.assert_allclose(forces[:, 2], -10, atol=0.02)
    np.testing.assert_allclose(forces[:, 0], 5, rtol=0.01)


def test_an_eraser_that_lands_undamped_at_5_cm_per_second_does_not_bounce():
    slide = _Slide(speed=0.0, damping=0.0)
    slide.plant.SetPositions(slide.context, [0, 0.005])
    slide.plant.SetVelocities(slide.context, [0, -0.05])
    contact = np.array([slide.Step()[0][2] < 0 for _ in range(1500)])
    assert contact[-1]
    assert np.count_nonzero(np.diff(contact.astype(int))) == 1
