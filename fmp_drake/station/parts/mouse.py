"""The mouse on the page: pulling bodies, and leading the tool."""

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.lcm import DrakeLcm
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

from fmp_drake.errors import StationError
from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.mouse_hand import MouseHand
from fmp_drake.systems.teaching.mouse_drag import LEADING, BoardPlane

# Of Drake's spring: its ratio of damping to stiffness is 1 / sqrt of this, 0.1 s.
_SPECIFIC_STIFFNESS = 100.0


def AddMousePull(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    meshcat: Meshcat,
) -> OutputPort:
    """Add a spring between the mouse and the body that it drags in the page.

    A drag begins with the Ctrl key and the left button on a body that Drake's
    MeshcatVisualizer shows. The spring pulls at the point that was grabbed, towards
    the mouse in the plane of the screen.

    Systems: meshcat_mouse_spring (Drake's), mouse_hand.

    Parameters
    ----------
    builder : DiagramBuilder
    plant : MultibodyPlant
        Finalized; its applied_spatial_force port is not connected yet.
    scene_graph : SceneGraph
    meshcat : Meshcat

    Returns
    -------
    OutputPort
        The forces, for the plant's applied_spatial_force port or a sum in front of
        it; the caller connects it.

    Raises
    ------
    StationError
        Where the plant's port is connected already.
    """
    hand = MouseHand(plant, specific_stiffness=_SPECIFIC_STIFFNESS)
    _Connect(builder, hand, plant, scene_graph, meshcat)
    return hand.GetOutputPort("spatial_forces")


def AddMouseHand(
    builder: DiagramBuilder, scene: BoardScene, scenario: Scenario, meshcat: Meshcat
) -> MouseHand:
    """Add a hand that leads the eraser over the board by the mouse.

    A drag of the eraser or any link, with the Ctrl key and the left button, leads the
    eraser in parallel to the board; where it is let go it is held. Systems:
    meshcat_mouse_spring (Drake's), mouse_hand.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : BoardScene
        Nothing is connected to its plant's applied_spatial_force port yet; the caller
        connects the hand's port to it.
    scenario : Scenario
    meshcat : Meshcat
        Printed with ``?tracked_camera=on``, it tells where its camera is; else that is
        taken to be the scenario's.
    """
    board, plant = scenario.board, scene.plant
    size, felt = np.array(board.size), np.array(scenario.eraser.footprint)
    eraser = plant.GetModelInstanceByName("eraser")
    hand = MouseHand(
        plant,
        meshcat=meshcat,
        specific_stiffness=_SPECIFIC_STIFFNESS,
        config=LEADING,
        bodies=[i for m in (scene.panda, eraser) for i in plant.GetBodyIndices(m)],
        tip=scene.tip,
        board=BoardPlane(scene.X_WB.GetAsMatrix34(), (size - felt) / 2),
        eye=scenario.camera.eye,
    )
    _Connect(builder, hand, plant, scene.scene_graph, meshcat)
    return hand


def _Connect(
    builder: DiagramBuilder,
    hand: MouseHand,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    meshcat: Meshcat,
) -> None:
    """Add a hand to what Drake's mouse spring and the plant say."""
    before = len(builder.GetSystems())
    config = VisualizationConfig(
        publish_illustration=False,
        publish_proximity=False,
        publish_inertia=False,
        publish_contacts=False,
        enable_meshcat_creation=False,
        mouse_interaction_stiffness=_SPECIFIC_STIFFNESS,
    )
    ApplyVisualizationConfig(
        config,
        builder,
        plant=plant,
        scene_graph=scene_graph,
        meshcat=meshcat,
        lcm=DrakeLcm("memq://null"),
    )
    # Drake skips a plant whose port is connected.
    if len(builder.GetSystems()) == before:
        raise StationError(
            "the plant's applied_spatial_force is connected already; add the mouse "
            "first, and connect the sum of all forces then."
        )
    spring = builder.GetSystems()[-1]
    # Drake gives it to the plant; here it goes through the hand.
    builder.Disconnect(
        spring.get_output_port(), plant.GetInputPort("applied_spatial_force")
    )
    builder.AddSystem(hand)
    builder.Connect(spring.get_output_port(), hand.GetInputPort("spring"))
    for port in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(port), hand.GetInputPort(port))
