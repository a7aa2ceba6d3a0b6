"""A station seen by a camera: colours and depths, rendered without a screen."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import (
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram

from fmp_drake.errors import RunError
from fmp_drake.film.camera import FilmCamera, pixel_rays
from fmp_drake.numeric import finite_array
from fmp_drake.station.parts.stage import RenderLights

_RENDERER = "film"


class Shot(NamedTuple):
    """What the camera sees at one moment.

    Attributes
    ----------
    color : ndarray of uint8, shape (height, width, 3)
        sRGB.
    depth : ndarray of float32, shape (height, width)
        Distance along the camera's z, m; infinite where there is nothing.
    X_CB : RigidTransform
        The board in the camera's frame.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    X_CB: RigidTransform


class FilmScene:
    """Renders the arm, the eraser and the board of a station as a camera sees them.

    The station itself stays as it is: positions are set in a Context of its own.

    Parameters
    ----------
    station : Diagram
        With subsystems plant and scene_graph; the plant has a frame `surface`, B.
    diagram : Diagram, optional
        The root diagram that contains the station; the station itself where None.
    camera : FilmCamera
    size : tuple of int
        Width and height, pixels.
    """

    def __init__(
        self,
        station: Diagram,
        *,
        diagram: Diagram | None = None,
        camera: FilmCamera,
        size: tuple[int, int],
    ) -> None:
        plant: Any = station.GetSubsystemByName("plant")
        scene_graph: Any = station.GetSubsystemByName("scene_graph")
        context = (diagram or station).CreateDefaultContext()
        self._plant = plant
        self._scene_graph = scene_graph
        self._plant_context = plant.GetMyMutableContextFromRoot(context)
        self._graph_context = scene_graph.GetMyMutableContextFromRoot(context)
        params = RenderLights()
        params.backend = "EGL"
        engine = MakeRenderEngineVtk(params)
        scene_graph.AddRenderer(self._graph_context, _RENDERER, engine)
        self._surface = plant.GetFrameByName("surface")
        self._X_WC = camera.pose()
        core = camera.core(_RENDERER, size)
        clip = core.clipping()
        self._color = ColorRenderCamera(core, show_window=False)
        self._depth = DepthRenderCamera(core, DepthRange(clip.near(), clip.far()))
        self.rays = pixel_rays(core)

    def render(self, q: ArrayLike) -> Shot:
        """Render the station with the plant at positions (nq,)."""
        shape = (self._plant.num_positions(),)
        values = finite_array(q, "the positions of a frame", shape, error=RunError)
        self._plant.SetPositions(self._plant_context, values)
        query = self._scene_graph.get_query_output_port().Eval(self._graph_context)
        world = self._scene_graph.world_frame_id()
        color = query.RenderColorImage(self._color, world, self._X_WC).data
        depth = query.RenderDepthImage(self._depth, world, self._X_WC).data
        X_WB = self._surface.CalcPoseInWorld(self._plant_context)
        return Shot(
            color=np.array(color[..., :3]),
            depth=np.array(depth[..., 0]),
            X_CB=self._X_WC.inverse() @ X_WB,
        )
