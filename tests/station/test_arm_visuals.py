"""Facts about the arms' meshes: our own, and the Panda's of Drake's drake_models."""

import base64
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Capsule, Mesh, Role
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.robots.robot import AddArm, AddRobot, LoadRobot

JOINTS = {"panda": 7, "iiwa14": 7, "ur5e": 6}
MESHES = [
    models_dir() / arm / "meshes" / f"link{i}.gltf"
    for arm, n in JOINTS.items()
    for i in range(n + 1)
]
PANDA = LoadRobot("panda")


def _Arrays(path):
    """Return each primitive of a glTF file as (positions, normals, triangles)."""
    file = json.loads(path.read_text())
    blob = base64.b64decode(file["buffers"][0]["uri"].partition(",")[2])

    def array(index):
        accessor = file["accessors"][index]
        view = file["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
        data = blob[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(data, kind).reshape(-1, 3)

    return [
        (
            array(p["attributes"]["POSITION"]),
            array(p["attributes"]["NORMAL"]),
            array(p["indices"]),
        )
        for p in file["meshes"][0]["primitives"]
    ]


@pytest.mark.parametrize(
    ("arm", "names"),
    [
        ("panda", ["link3", "link6"]),
        ("iiwa14", ["link6", "link7"]),
        ("ur5e", ["link5", "link6"]),
    ],
)
def test_the_script_makes_the_meshes_that_are_in_the_project(arm, names, tmp_path):
    code = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(models_dir() / arm)!r})
import make_meshes
links = [getattr(make_meshes, name) for name in {names}]
make_meshes.write_meshes(links, Path({str(tmp_path)!r}))
"""
    subprocess.run([sys.executable, "-B", "-c", code], check=True, timeout=300)
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{n}.gltf" for n in names]
    for name in names:
        folders = (tmp_path, models_dir() / arm / "meshes")
        new_mesh, stored_mesh = (_Arrays(folder / f"{name}.gltf") for folder in folders)
        assert len(new_mesh) == len(stored_mesh)
        for new, old in zip(new_mesh, stored_mesh, strict=True):
            np.testing.assert_allclose(new[0], old[0], atol=2e-5)
            np.testing.assert_allclose(new[1], old[1], atol=2e-3)
            np.testing.assert_array_equal(new[2], old[2])


@pytest.mark.parametrize("arm", JOINTS)
def test_the_meshes_are_small_enough_for_a_page(arm):
    meshes = sorted((models_dir() / arm / "meshes").iterdir())
    assert [mesh.stem for mesh in meshes] == [f"link{i}" for i in range(len(meshes))]
    assert len(meshes) == JOINTS[arm] + 1
    assert sum(mesh.stat().st_size for mesh in meshes) < 1.2e6
    triangles = sum(len(part[2]) for mesh in meshes for part in _Arrays(mesh))
    assert 10_000 < triangles < 40_000


@pytest.mark.parametrize(
    "mesh", MESHES, ids=lambda mesh: f"{mesh.parts[-3]} {mesh.stem}"
)
def test_normals_have_unit_length_and_agree_with_their_triangles(mesh):
    for p, n, faces in _Arrays(mesh):
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-3)
        a, b, c = (p[faces[:, i]] for i in range(3))
        area = np.cross(b - a, c - a)
        along = np.einsum("fi,fi->f", area, n[faces].mean(axis=1))
        big = np.linalg.norm(area, axis=1) > 1e-7
        assert np.mean(along[big] > 0) > 0.998


@pytest.mark.parametrize("arm", JOINTS)
def test_every_link_shows_its_own_mesh_and_touches_with_capsules_if_it_moves(arm):
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), DiagramBuilder())
    model = AddRobot(plant, LoadRobot(arm)).arm
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    for i in range(JOINTS[arm] + 1):
        body = plant.GetBodyByName(f"{arm}_link{i}", model)
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        (mesh,) = inspector.GetGeometries(frame, Role.kIllustration)
        assert inspector.GetShape(mesh).source().path().name == f"link{i}.gltf"
        touching = inspector.GetGeometries(frame, Role.kProximity)
        assert bool(touching) == (i > 0)
        assert all(isinstance(inspector.GetShape(g), Capsule) for g in touching)


# The official meshes. There is no network here: a small folder stands for them.

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n"


@pytest.fixture
def official(tmp_path):
    """Return a package map whose drake_models is a small folder."""
    root = tmp_path / "drake_models"
    arm = root / "franka_description" / "urdf" / "panda_arm.urdf"
    meshes = root / "franka_description" / "meshes"
    arm.parent.mkdir(parents=True)
    meshes.mkdir()
    links = ""
    for i in range(8):
        (meshes / f"theirs{i}.obj").write_text(TRIANGLE)
        links += (
            f'<link name="panda_link{i}"><inertial><mass value="99"/></inertial>'
            '<visual><origin rpy="1.5 0 0" xyz="0 0 0.25"/><geometry><mesh filename='
            f'"package://drake_models/franka_description/meshes/theirs{i}.obj"/>'
            "</geometry></visual></link>"
        )
    arm.write_text(f'<robot name="panda">{links}</robot>')
    packages = PackageMap()
    packages.AddPackageXml(str(models_dir() / "package.xml"))
    packages.Remove("drake_models")
    packages.Add("drake_models", str(root))
    return packages, arm


def add_arm(plant, packages, visuals="drake_models"):
    """Add a Panda with the meshes of a package map."""
    parser = Parser(plant)
    parser.package_map().Remove("drake_models")
    parser.package_map().AddMap(packages)
    return AddArm(
        parser, Path(PANDA.model), visuals=visuals, official=PANDA.official_visuals
    )


def test_the_official_visuals_replace_ours_on_the_same_links(official):
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), DiagramBuilder())
    panda = add_arm(plant, official[0])
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    for i in range(8):
        body = plant.GetBodyByName(f"panda_link{i}", panda)
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        (geometry,) = inspector.GetGeometries(frame, Role.kIllustration)
        shape = inspector.GetShape(geometry)
        assert isinstance(shape, Mesh)
        assert shape.source().path().name == f"theirs{i}.obj"
        X_LM = inspector.GetPoseInFrame(geometry)
        np.testing.assert_allclose(X_LM.translation(), [0, 0, 0.25])


def test_the_official_visuals_leave_the_dynamics_alone(official):
    masses = []
    for visuals in ("own", "drake_models"):
        plant = MultibodyPlant(1e-3)
        add_arm(plant, official[0], visuals)
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("panda_link0"))
        plant.Finalize()
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, [0, -0.8, 0, -2.3, 0, 1.5, 0.8])
        masses.append(plant.CalcMassMatrix(context))
    np.testing.assert_array_equal(*masses)


def test_error_without_a_download_gives_advice(official):
    packages, _ = official
    packages.Remove("drake_models")
    packages.AddRemote(
        "drake_models",
        PackageMap.RemoteParams(urls=["file:///nowhere.tar.gz"], sha256="0" * 64),
    )
    with pytest.raises(StationError, match="could not be downloaded") as caught:
        add_arm(MultibodyPlant(1e-3), packages)
    assert "DRAKE_ALLOW_NETWORK" in str(caught.value)
    assert "package_map" in str(caught.value)
    assert "visuals: own" in str(caught.value)


def test_an_official_arm_without_a_link_is_an_error_that_names_it(official):
    packages, arm = official
    arm.write_text(arm.read_text().replace("panda_link3", "another_name"))
    with pytest.raises(StationError, match="no visual on panda_link3"):
        add_arm(MultibodyPlant(1e-3), packages)


def test_an_official_folder_without_the_arm_is_an_error_that_names_the_file(official):
    packages, arm = official
    arm.unlink()
    with pytest.raises(StationError, match=r"panda_arm\.urdf cannot be read"):
        add_arm(MultibodyPlant(1e-3), packages)


def test_an_arm_without_official_visuals_is_an_error_that_names_it():
    with pytest.raises(StationError, match=r"iiwa14\.urdf has no official meshes"):
        AddRobot(MultibodyPlant(1e-3), LoadRobot("iiwa14"), visuals="drake_models")


def test_visuals_of_another_kind_are_an_error_that_lists_the_kinds():
    with pytest.raises(StationError, match=r"'fancy'.*own, drake_models"):
        AddRobot(MultibodyPlant(1e-3), PANDA, visuals="fancy")
