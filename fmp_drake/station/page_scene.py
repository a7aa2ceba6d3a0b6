"""What a page shows of a station, added to its diagram."""


from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.station.board_scene import BoardScene

# Every station's bodies are drawn under this path of Meshcat's tree.
BODIES = "bodies"
BOARD = f"{BODIES}/whiteboard/board"
"""Where the board's body is in Meshcat's tree: what is drawn on the board is under
it, and moves with it, on the page and in recordings."""


def AddBodies(builder: DiagramBuilder, scene: BoardScene, meshcat: Meshcat) -> None:
    """Show arm, eraser and board: system meshcat_visualizer."""
    meshcat.Delete(BODIES)
    visualizer = MeshcatVisualizer.AddToBuilder(
        builder,
        scene.scene_graph,
        meshcat,
        # What others draw on the board outlives an initialisation.
        MeshcatVisualizerParams(prefix=BODIES, delete_on_initialization_event=False),
    )
    visualizer.set_name("meshcat_visualizer")
    meshcat.SetTransform(BOARD, scene.X_WB)
