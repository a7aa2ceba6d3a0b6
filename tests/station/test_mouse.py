"""Facts about the mouse spring of a station, without a browser."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from page_mouse import PageMouse
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.external_forces import AddMousePull
from fmp_drake.station.scenario import LoadScenario

BODIES = ["eraser/eraser", "panda/panda_link5", "panda/panda_link3"]


class Scene:
    """A scene whose bodies the mouse may pull; nothing holds the arm."""

    def __init__(self):
        self.meshcat = Meshcat()
        builder = DiagramBuilder()
        scene = AddBoardScene(builder, LoadScenario("table_top"), start=[0, 0, 0.1])
        self.plant = scene.plant
        MeshcatVisualizer.AddToBuilder(
            builder,
            scene.scene_graph,
            self.meshcat,
            MeshcatVisualizerParams(prefix="bodies"),
        )
        self.pull = AddMousePull(builder, self.plant, scene.scene_graph, self.meshcat)
        builder.Connect(self.pull, self.plant.GetInputPort("applied_spatial_force"))
        self.arm = scene.robot.arm
        builder.ExportInput(
            self.plant.get_actuation_input_port(scene.robot.arm), "torque"
        )
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.simulator.Initialize()
        context = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyContextFromRoot(context)
        rest = np.zeros(self.plant.num_actuators())
        self.diagram.GetInputPort("torque").FixValue(context, rest)
        self.mouse = PageMouse(self.meshcat, self.pose, eye=[1, 1, 1], target=[0, 0, 0])
        self.advance(0.02)

    def body(self, name):
        model, body = name.split("/")
        instance = self.plant.GetModelInstanceByName(model)
        return self.plant.GetBodyByName(body, instance)

    def pose(self, name):
        return self.body(name).EvalPoseInWorld(self.context)

    def drag(self, name, way, *, frames=20):
        """Drag a body by the origin of its frame, in the plane of the screen."""
        self.mouse.press(name, self.pose(name).translation())
        start = self.pose(name).translation()
        for i in range(1, frames + 1):
            self.advance(0.016)
            anchor = self.pose(name).translation()
            self.mouse.send(anchor, start + i / frames * np.array(way))
        self.advance(0.016)
        return start + way

    def advance(self, seconds):
        time = self.simulator.get_context().get_time()
        self.simulator.AdvanceTo(time + seconds)

    def forces(self):
        system = self.pull.get_system()
        return self.pull.Eval(system.GetMyContextFromRoot(self.simulator.get_context()))


@pytest.fixture
def scene():
    return Scene()


@pytest.mark.parametrize("name", BODIES)
def test_a_drag_pulls_every_body_with_the_same_stiffness(scene, name):
    q = scene.plant.GetPositions(scene.context, scene.arm)
    cursor = scene.drag(name, [0.0, 0.03, 0.04])
    (force,) = scene.forces()
    body = scene.body(name)
    assert force.body_index == body.index()
    v = body.EvalSpatialVelocityInWorld(scene.context).translational()
    away = cursor - scene.pose(name).translation()
    f = force.F_Bq_W.translational()
    assert_allclose(f, 400 * away - 40 * v, atol=1e-6)
    assert np.abs(scene.plant.GetPositions(scene.context, scene.arm) - q).max() > 1e-3


def test_a_far_drag_pulls_like_a_person(scene):
    scene.drag(BODIES[1], [0.0, 0.8, 0.0], frames=40)
    (force,) = scene.forces()
    assert np.linalg.norm(force.F_Bq_W.translational()) < 40.001


def test_end_of_a_drag_releases_the_arm(scene):
    scene.drag(BODIES[0], [0.0, 0.1, 0.0])
    assert len(scene.forces()) == 1
    scene.mouse.release()
    scene.advance(0.016)
    assert scene.forces() == []


def test_frozen_page_releases_the_arm(scene):
    scene.drag(BODIES[0], [0.0, 0.1, 0.0])
    scene.advance(0.4)
    assert scene.forces() == []


def test_two_pages_do_not_disturb_each_other(scene):
    other = Scene()
    scene.drag(BODIES[0], [0.0, 0.1, 0.0])
    other.advance(0.016)
    assert len(scene.forces()) == 1
    assert other.forces() == []


def test_a_plant_whose_forces_are_connected_already_is_refused():
    builder = DiagramBuilder()
    scene = AddBoardScene(builder, LoadScenario("table_top"), start=[0, 0, 0.1])
    meshcat = Meshcat()
    port = AddMousePull(builder, scene.plant, scene.scene_graph, meshcat)
    builder.Connect(port, scene.plant.GetInputPort("applied_spatial_force"))
    with pytest.raises(StationError, match="connected already"):
        AddMousePull(builder, scene.plant, scene.scene_graph, meshcat)
