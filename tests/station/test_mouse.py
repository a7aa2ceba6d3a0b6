"""Facts about the mouse spring of a station, without a browser."""

import numpy as np
import pytest
import umsgpack
from numpy.testing import assert_allclose
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import StationError
from fmp_drake.station.parts.board_scene import AddBoardScene
from fmp_drake.station.parts.mouse import AddMousePull
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
        self.arm = scene.panda
        builder.ExportInput(self.plant.get_actuation_input_port(scene.panda), "torque")
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.simulator.Initialize()
        context = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyContextFromRoot(context)
        rest = np.zeros(self.plant.num_actuators())
        self.diagram.GetInputPort("torque").FixValue(context, rest)

    def body(self, name):
        model, body = name.split("/")
        instance = self.plant.GetModelInstanceByName(model)
        return self.plant.GetBodyByName(body, instance)

    def drag(self, name, anchor, target):
        """Say what the page says while somebody drags a body."""
        message = {
            "type": "mouse_drag",
            "name": f"/drake/bodies/{name}/visual/<object>" if name else "",
            "drag_anchor": list(map(float, anchor)),
            "drag_target": list(map(float, target)),
        }
        self.meshcat._InjectWebsocketMessage(umsgpack.packb(message))

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
def test_a_short_drag_pulls_every_body_with_the_same_stiffness(scene, name):
    body = scene.body(name)
    origin = body.EvalPoseInWorld(scene.context).translation()
    grabbed = np.add(origin, [0.0, 0.0, 0.01])
    scene.drag(name, grabbed, np.add(grabbed, [0.0, 0.03, 0.04]))
    scene.advance(0.0105)
    (force,) = scene.forces()
    assert force.body_index == body.index()
    assert_allclose(force.F_Bq_W.translational(), 400 * np.array([0, 0.03, 0.04]), 0.1)
    q = scene.plant.GetPositions(scene.context, scene.arm)
    scene.advance(0.1)
    assert np.abs(scene.plant.GetPositions(scene.context, scene.arm) - q).max() > 1e-4


def test_a_far_drag_pulls_like_a_person(scene):
    anchor = scene.body(BODIES[0]).EvalPoseInWorld(scene.context).translation()
    scene.drag(BODIES[0], anchor, np.add(anchor, [0.0, 0.5, 0.0]))
    scene.advance(0.0105)
    (force,) = scene.forces()
    assert_allclose(np.linalg.norm(force.F_Bq_W.translational()), 40.0)


def test_the_end_of_a_drag_lets_go(scene):
    anchor = scene.body(BODIES[0]).EvalPoseInWorld(scene.context).translation()
    scene.drag(BODIES[0], anchor, np.add(anchor, [0.0, 0.1, 0.0]))
    scene.advance(0.0105)
    assert len(scene.forces()) == 1
    scene.drag("", [], [])
    scene.advance(0.0105)
    assert scene.forces() == []


def test_two_pages_do_not_disturb_each_other(scene):
    other = Scene()
    anchor = scene.body(BODIES[0]).EvalPoseInWorld(scene.context).translation()
    scene.drag(BODIES[0], anchor, np.add(anchor, [0.0, 0.1, 0.0]))
    for each in (scene, other):
        each.advance(0.0105)
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
