"""Facts about the arm's meshes: our own, and those of Drake's drake_models."""

import base64
import json
import subprocess
import sys

import numpy as np
import pytest
from pydrake.geometry import Capsule, Mesh, Role
from pydrake.multibody.parsing import PackageMap
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station.models.model_files import AddPandaWithEraser, models_dir
from fmp_drake.station.models.panda import AddPanda

LINKS = [f"link{i}" for i in range(8)]
MESHES = models_dir() / "panda" / "meshes"


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


def test_the_script_makes_the_meshes_that_are_in_the_project(tmp_path):
    names = ["link3", "link6"]
    code = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(models_dir() / "panda")!r})
import make_meshes
make_meshes.LINKS = [getattr(make_meshes, name) for name in {names}]
make_meshes.main(Path({str(tmp_path)!r}))
"""
    subprocess.run([sys.executable, "-B", "-c", code], check=True, timeout=300)
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{n}.gltf" for n in names]
    for name in names:
        made, kept = (_Arrays(d / f"{name}.gltf") for d in (tmp_path, MESHES))
        assert len(made) == len(kept)
        for new, old in zip(made, kept, strict=True):
            np.testing.assert_allclose(new[0], old[0], atol=2e-5)
            np.testing.assert_allclose(new[1], old[1], atol=2e-3)
            np.testing.assert_array_equal(new[2], old[2])


def test_the_meshes_are_small_enough_for_a_page():
    assert sum(p.stat().st_size for p in MESHES.iterdir()) < 1.5e6
    triangles = sum(
        len(part[2]) for name in LINKS for part in _Arrays(MESHES / f"{name}.gltf")
    )
    assert 10_000 < triangles < 40_000


@pytest.mark.parametrize("name", LINKS)
def test_normals_have_unit_length_and_agree_with_their_triangles(name):
    for p, n, faces in _Arrays(MESHES / f"{name}.gltf"):
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-3)
        a, b, c = (p[faces[:, i]] for i in range(3))
        area = np.cross(b - a, c - a)
        along = np.einsum("fi,fi->f", area, n[faces].mean(axis=1))
        big = np.linalg.norm(area, axis=1) > 1e-7
        assert np.mean(along[big] > 0) > 0.998


def test_every_link_shows_its_own_mesh_and_touches_with_capsules_if_it_moves():
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), DiagramBuilder())
    panda, _ = AddPandaWithEraser(plant)
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    for i in range(8):
        body = plant.GetBodyByName(f"panda_link{i}", panda)
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


def test_the_official_visuals_replace_ours_on_the_same_links(official):
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), DiagramBuilder())
    panda = AddPanda(plant, packages=official[0], visuals="drake_models")
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
        AddPanda(plant, packages=official[0], visuals=visuals)
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("panda_link0"))
        plant.Finalize()
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, [0, -0.8, 0, -2.3, 0, 1.5, 0.8])
        masses.append(plant.CalcMassMatrix(context))
    np.testing.assert_array_equal(*masses)


def test_without_a_download_the_error_says_what_to_do(official):
    packages, _ = official
    packages.Remove("drake_models")
    packages.AddRemote(
        "drake_models",
        PackageMap.RemoteParams(urls=["file:///nowhere.tar.gz"], sha256="0" * 64),
    )
    with pytest.raises(StationError, match="could not be downloaded") as caught:
        AddPanda(MultibodyPlant(1e-3), packages=packages, visuals="drake_models")
    assert "DRAKE_ALLOW_NETWORK" in str(caught.value)
    assert "package_map" in str(caught.value)
    assert "visuals: own" in str(caught.value)


def test_an_official_arm_without_a_link_is_an_error_that_names_it(official):
    packages, arm = official
    arm.write_text(arm.read_text().replace("panda_link3", "another_name"))
    with pytest.raises(StationError, match="no visual on panda_link3"):
        AddPanda(MultibodyPlant(1e-3), packages=packages, visuals="drake_models")


def test_an_official_folder_without_the_arm_is_an_error_that_names_the_file(official):
    packages, arm = official
    arm.unlink()
    with pytest.raises(StationError, match=r"panda_arm\.urdf cannot be read"):
        AddPanda(MultibodyPlant(1e-3), packages=packages, visuals="drake_models")


def test_visuals_of_another_kind_are_an_error_that_lists_the_kinds():
    with pytest.raises(StationError, match=r"'fancy'.*own, drake_models"):
        AddPandaWithEraser(MultibodyPlant(1e-3), visuals="fancy")
