"""Pulling bodies with the mouse in the browser."""

from pydrake.geometry import Meshcat, SceneGraph
from pydrake.lcm import DrakeLcm
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

from fmp_drake.errors import StationError
from fmp_drake.systems.mouse_pull import MousePull

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

    Systems: meshcat_mouse_spring (Drake's), mouse_pull.

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
    # Drake gives it to the plant; here it goes through the pull.
    builder.Disconnect(
        spring.get_output_port(), plant.GetInputPort("applied_spatial_force")
    )
    pull = builder.AddSystem(MousePull(plant, specific_stiffness=_SPECIFIC_STIFFNESS))
    builder.Connect(spring.get_output_port(), pull.GetInputPort("spring"))
    return pull.GetOutputPort("spatial_force")
