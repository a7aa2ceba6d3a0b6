"""Facts about the whiteboard and the eraser in sizes other than the usual ones."""

import numpy as np
import pytest
from pydrake.geometry import Box, Convex, Role
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import RigidBody, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station.models.eraser import AddEraser
from fmp_drake.station.models.whiteboard import AddWhiteboard
from fmp_drake.station.robots.robot import AddRobot, LoadRobot
from fmp_drake.station.scenario_parts import BoardConfig, EraserConfig


def _Scene(add, config):
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), DiagramBuilder())
    instance = add(plant, config)
    plant.Finalize()
    return plant, scene_graph.model_inspector(), instance


def _Eraser(**values):
    return _Scene(AddEraser, EraserConfig(**values))


def _Board(**values):
    return _Scene(AddWhiteboard, BoardConfig(**values))


def _Inertia(plant: MultibodyPlant, name: str) -> SpatialInertia:
    body = plant.GetBodyByName(name)
    assert isinstance(body, RigidBody)
    return body.default_spatial_inertia()


def _Properties(inspector, name):
    (touching,) = (
        g
        for g in inspector.GetAllGeometryIds(Role.kProximity)
        if inspector.GetName(g).endswith(f"::{name}")
    )
    properties = inspector.GetProximityProperties(touching)
    shape = inspector.GetShape(touching)
    if isinstance(shape, Convex):
        hull = shape.GetConvexHull()
        size = np.ptp([hull.vertex(i) for i in range(hull.num_vertices())], axis=0)
    else:
        size = shape.size()
    return (
        size,
        properties.GetProperty("hydroelastic", "hydroelastic_modulus"),
        properties.GetProperty("material", "hunt_crossley_dissipation"),
        properties.GetProperty("material", "coulomb_friction"),
    )


def _Central(inertia: SpatialInertia) -> np.ndarray:
    return inertia.Shift(inertia.get_com()).CalcRotationalInertia().get_moments()


# The numbers of the two models that every measured figure was taken with.


def test_the_default_eraser_is_the_measured_one():
    plant, inspector, _ = _Eraser()
    inertia = _Inertia(plant, "eraser")
    assert inertia.get_mass() == 0.253417
    np.testing.assert_array_equal(inertia.get_com(), [0, 0, 0.0423968])
    np.testing.assert_allclose(
        _Central(inertia), [0.000270186, 0.000410762, 0.000244306], rtol=1e-12
    )
    size, modulus, dissipation, friction = _Properties(inspector, "felt")
    np.testing.assert_array_equal(size, [0.12, 0.05, 0.03])
    assert (modulus, dissipation) == (1.25e4, 20)
    assert friction.static_friction() == friction.dynamic_friction() == 0.5


def test_the_default_board_is_the_measured_one():
    plant, inspector, _ = _Board()
    inertia = _Inertia(plant, "board")
    assert inertia.get_mass() == 3.5
    np.testing.assert_array_equal(inertia.get_com(), [0, 0, -0.01])
    np.testing.assert_allclose(
        _Central(inertia), [0.143033, 0.073033, 0.215833], rtol=5e-6
    )
    size, modulus, dissipation, friction = _Properties(inspector, "slab")
    np.testing.assert_array_equal(size, [0.5, 0.7, 0.02])
    assert (modulus, dissipation) == (1e7, 0)
    assert friction.static_friction() == friction.dynamic_friction() == 0.5


def test_a_board_has_the_size_and_the_friction_that_it_is_given():
    plant, inspector, board = _Board(size=(0.9, 1.2), friction=0.12, legs=False)
    size, _, _, friction = _Properties(inspector, "slab")
    np.testing.assert_array_equal(size, [0.9, 1.2, 0.02])
    assert friction.static_friction() == 0.12
    inertia = _Inertia(plant, "board")
    assert inertia.get_mass() == pytest.approx(3.5 * (0.9 * 1.2) / (0.5 * 0.7))
    assert inertia.IsPhysicallyValid()
    assert plant.GetModelInstanceName(board) == "whiteboard"
    assert plant.GetFrameByName("surface", board).body().name() == "board"


def test_an_eraser_has_the_felt_that_it_is_given():
    plant, inspector, _ = _Eraser(footprint=(0.08, 0.08), modulus=5e4, friction=0.9)
    size, modulus, _, friction = _Properties(inspector, "felt")
    np.testing.assert_array_equal(size, [0.08, 0.08, 0.03])
    core, *_ = _Properties(inspector, "core")
    np.testing.assert_allclose(core, [0.07, 0.07, 0.018])
    assert modulus == 5e4
    assert friction.dynamic_friction() == 0.9
    moments = _Central(_Inertia(plant, "eraser"))
    assert moments[0] == pytest.approx(moments[1], rel=1e-12)
    assert _Inertia(plant, "eraser").IsPhysicallyValid()


def test_the_arm_carries_the_eraser_that_it_is_given():
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), DiagramBuilder())
    eraser = EraserConfig(footprint=[0.2, 0.1], modulus=2e4, friction=0.3)
    AddRobot(plant, LoadRobot("panda"), eraser)
    plant.Finalize()
    size, modulus, _, friction = _Properties(scene_graph.model_inspector(), "felt")
    np.testing.assert_array_equal(size, [0.2, 0.1, 0.03])
    assert (modulus, friction.static_friction()) == (2e4, 0.3)


def test_only_a_board_with_legs_has_legs():
    for legs in (True, False):
        _, inspector, _ = _Board(legs=legs)
        names = [
            inspector.GetName(g)
            for g in inspector.GetAllGeometryIds(Role.kIllustration)
        ]
        assert any("leg" in name for name in names) == legs


@pytest.mark.parametrize("size", [(0.5, 0.7), (0.1, 0.1), (1.5, 0.4)])
def test_drawing_of_a_board_leaves_its_surface_free(size):
    _, inspector, _ = _Board(size=size)
    for g in inspector.GetAllGeometryIds(Role.kIllustration):
        if inspector.GetName(g) in ("whiteboard::slab", "whiteboard::slab_rendered"):
            continue
        p_BG = inspector.GetPoseInFrame(g).translation()
        shape = inspector.GetShape(g)
        half = np.array(shape.size()) / 2 if isinstance(shape, Box) else [0.02] * 3
        on_top = p_BG[2] + half[2] > 0
        inside = np.all(np.abs(p_BG[:2]) + half[:2] < np.array(size) / 2 - 0.03)
        assert not (on_top and inside)


def test_each_drawn_shape_is_there_once_for_the_page_and_once_for_the_renderer():
    for _, inspector, _ in (_Eraser(), _Board()):
        page = inspector.GetAllGeometryIds(Role.kIllustration)
        rendered = inspector.GetAllGeometryIds(Role.kPerception)
        assert len(page) == len(rendered) > 0
        assert set(page).isdisjoint(rendered)


def test_the_renderer_gets_the_page_s_colour_without_its_gamma():
    _, inspector, _ = _Eraser()
    (blue,) = (
        inspector.GetPerceptionProperties(g).GetProperty("phong", "diffuse")
        for g in inspector.GetAllGeometryIds(Role.kPerception)
        if inspector.GetName(g) == "eraser::handle_rendered"
    )
    np.testing.assert_allclose(
        [blue.r(), blue.g(), blue.b()], [0.01002, 0.08354, 0.34239], atol=1e-5
    )


@pytest.mark.parametrize(
    ("add", "values", "complaint"),
    [
        (_Board, {"size": (0.05, 0.7)}, r"board\.size\[0\] .* at least 0\.1"),
        (_Eraser, {"modulus": 0.0}, r"eraser\.modulus is 0\.0; .* positive"),
    ],
)
def test_an_invalid_value_is_an_error_that_names_it(add, values, complaint):
    with pytest.raises(StationError, match=complaint):
        add(**values)
