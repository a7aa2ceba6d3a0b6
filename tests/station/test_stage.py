"""Facts about the stage: what the page and the renderer show."""

import numpy as np
import pytest
import umsgpack
from browser import needs_chromium, screenshot
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    MakeRenderEngineVtk,
    Meshcat,
    MeshcatVisualizer,
    RenderCameraCore,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from fmp_drake.errors import StationError
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.models.whiteboard import AddWhiteboard
from fmp_drake.station.page import (
    FIELD_OF_VIEW,
    RenderLights,
    SetStage,
    ShowStill,
)
from fmp_drake.station.robots.robot import AddRobot, LoadRobot
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.scenario_parts import BoardConfig

EYE, TARGET = np.array([1.42, -0.92, 0.82]), np.array([0.36, 0.0, 0.25])
START = [0, -0.785, 0, -2.356, 0, 1.571, 0.785]


def _Scene(builder):
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(), builder)
    panda = AddRobot(plant, LoadRobot("panda")).arm
    AddWhiteboard(plant, BoardConfig())
    plant.WeldFrames(
        plant.world_frame(),
        plant.GetFrameByName("surface"),
        RigidTransform([0.55, 0, 0.10]),
    )
    plant.Finalize()
    plant.SetDefaultPositions(panda, START)
    return scene_graph


def _At(picture, p_WP, size):
    """Return the colour, 0 to 1, of the pixel that shows a point of the world."""
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    w = np.asarray(p_WP) - EYE
    focal = size[1] / 2 / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    u = size[0] / 2 + focal * (w @ right) / (w @ forward)
    v = size[1] / 2 + focal * (w @ np.cross(forward, right)) / (w @ forward)
    return picture[round(v), round(u)]


def _Check(picture, size):
    board = _At(picture, [0.70, -0.25, 0.10], size)
    assert board.min() > 0.85  # White, not grey.
    assert np.ptp(board) < 0.05
    arm = _At(picture, [0, -0.055, 0.21], size)
    assert 0.4 < arm.min() < 0.995  # Light, but neither grey nor blown out.
    corner = _At(picture, [0.30 + 0.5 - 0.008, -0.342, 0.1025], size)
    assert corner.max() < 0.35  # Dark.
    assert picture[5, 5].min() > 0.8  # A light background.


def test_the_renderer_shows_a_white_board_and_a_light_arm():
    builder = DiagramBuilder()
    scene_graph = _Scene(builder)
    params = RenderLights()
    params.backend = "EGL"
    scene_graph.AddRenderer("film", MakeRenderEngineVtk(params))
    context = builder.Build().CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(
        scene_graph.GetMyContextFromRoot(context)
    )
    forward = TARGET - EYE
    right = np.cross(forward, [0, 0, 1])
    axes = np.column_stack([right, np.cross(forward, right), forward])
    X_WC = RigidTransform(RotationMatrix(axes / np.linalg.norm(axes, axis=0)), EYE)
    size = (480, 360)
    core = RenderCameraCore(
        "film",
        CameraInfo(*size, np.radians(FIELD_OF_VIEW)),
        ClippingRange(0.05, 10),
        RigidTransform(),
    )
    image = query.RenderColorImage(
        ColorRenderCamera(core), scene_graph.world_frame_id(), X_WC
    )
    _Check(np.array(image.data)[..., :3] / 255.0, size)


@needs_chromium
def test_the_page_shows_a_white_board_and_a_light_arm(tmp_path):
    builder = DiagramBuilder()
    scene_graph = _Scene(builder)
    meshcat = Meshcat()
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
    SetStage(meshcat, eye=EYE, target=TARGET)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    page = tmp_path / "page.html"
    page.write_text(meshcat.StaticHtml())
    size = (720, 480)
    _Check(screenshot(page.as_uri(), tmp_path, size=size), size)


def test_the_page_s_lamp_stands_above_the_viewer_s_left_shoulder():
    class Record:
        def __init__(self):
            self.values = {}

        def SetProperty(self, path, name, value):
            self.values[path, name] = value

        def SetCamera(self, camera):
            self.camera = camera

        def SetCameraPose(self, eye, target):
            self.pose = eye, target

    record = Record()
    SetStage(record, eye=[0, -3, 1], target=[0, 0, 1])
    x, y, z = record.values["/Lights/SpotLight/<object>", "position"]
    assert x < -1
    assert y < -1
    assert z > 1
    assert not record.values["/Grid", "visible"]
    assert not record.values["/Axes", "visible"]
    np.testing.assert_array_equal(record.pose, [[0, -3, 1], [0, 0, 1]])


def test_films_have_one_lamp_that_casts_shadows():
    params = RenderLights()
    assert params.cast_shadows
    assert [lamp.type for lamp in params.lights].count("spot") == 1
    assert all(lamp.frame == "camera" for lamp in params.lights)


@pytest.mark.parametrize(
    ("eye", "target", "complaint"),
    [
        ([0, 0, 2], [0, 0, 0], "straight up or down"),
        ([1, 1, 1], [1, 1, 1], "straight up or down"),
        ([1, 0], [0, 0, 0], r"camera's eye of shape \(2,\); expected \(3,\)"),
        ([0, 0, 0], [np.nan, 0, 0], "infinite numbers in the camera's target"),
    ],
)
def test_camera_without_a_valid_direction_is_an_error(eye, target, complaint):
    with pytest.raises(StationError, match=complaint):
        SetStage(Meshcat(), eye=eye, target=target)


@pytest.mark.parametrize("name", ["stir", "wipe_dome"])
def test_tool_waits_at_the_start_of_a_run(name):
    """It was 13 cm below the bottom of the pot, and 25 cm below the top of the dome."""
    scenario, meshcat, builder = LoadScenario(name), Meshcat(), DiagramBuilder()
    ShowStill(scenario, meshcat)
    robot = AddBoardScene(builder, scenario, start=scenario.start).robot
    builder.Build()
    body = robot.tip.body()
    path = f"/drake/bodies/{body.scoped_name().get_full().replace('::', '/')}"
    packed = umsgpack.unpackb(meshcat._GetPackedTransform(path))
    X_WBody = RigidTransform(np.reshape(packed["matrix"], (4, 4)).T)
    tip = X_WBody @ robot.tip.GetFixedPoseInBodyFrame()
    p_BE = scenario.board.pose().inverse() @ tip.translation()
    np.testing.assert_allclose(p_BE, scenario.start, atol=1e-3)


def test_arm_is_shown_also_where_the_start_is_out_of_reach():
    scenario, meshcat = LoadScenario("table_top"), Meshcat()
    scenario.start = [3.0, 0.0, 0.05]
    ShowStill(scenario, meshcat)
    assert meshcat._GetPackedTransform("/drake/bodies/eraser/eraser") != b""


def test_background_has_its_colours_where_meshcat_looks_for_them():
    """Elsewhere the browser's console warns of each colour."""
    meshcat = Meshcat()
    SetStage(meshcat, eye=EYE, target=TARGET)
    for name in ("top_color", "bottom_color"):
        assert meshcat._GetPackedProperty("/Background", name) == b""
        assert meshcat._GetPackedProperty("/Background/<object>", name) != b""
