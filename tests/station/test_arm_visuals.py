"""Facts about the arms' meshes."""

import base64
import json
import subprocess
import sys

import numpy as np
import pytest
from pydrake.geometry import Capsule, Role
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.robots.robot import AddRobot, LoadRobot

JOINTS = {"panda": 7, "iiwa14": 7, "ur5e": 6}
MESHES = [
    models_dir() / arm / "meshes" / f"link{i}.gltf"
    for arm, n in JOINTS.items()
    for i in range(n + 1)
]


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
