"""Renderings of a station: colours and depths."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Diagram
from pydrake.systems.sensors import CameraInfo

from fmp_drake.station.page.stage import FIELD_OF_VIEW, CameraAxes, RenderLights
from fmp_drake.station.scenario_parts import CameraConfig

_RENDERER = "film"
_NEAR, _FAR = 0.05, 10.0  # Rendered distances, m.


class Shot(NamedTuple):
    """Picture of a station at one moment.

    Attributes
    ----------
    color : ndarray of uint8, shape (height, width, 3)
        sRGB.
    depth : ndarray of float32, shape (height, width)
        Distance along the camera's z, m; infinite where there is nothing.
    X_CB : RigidTransform
        The board in the camera's frame.
    info : CameraInfo
        Intrinsic parameters of the camera.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    X_CB: RigidTransform
    info: CameraInfo

    def points(self) -> NDArray[np.float64]:
        """Return the points p_B that are seen where the depth is finite, shape (N, 3), m."""
        rows, columns = np.nonzero(np.isfinite(self.depth))
        depth = self.depth[rows, columns].astype(float)
        # VTK puts the centre of pixel (i, j) at (i + 0.5, j + 0.5).
        x = (columns + 0.5 - self.info.center_x()) / self.info.focal_x()
        y = (rows + 0.5 - self.info.center_y()) / self.info.focal_y()
        p_C = depth * np.stack([x, y, np.ones_like(x)])
        return (self.X_CB.inverse() @ p_C).T.copy()

    def pixels(self, p_B: ArrayLike) -> NDArray[np.float64]:
        """Return column and row at which points p_B (N, 3) are seen, shape (N, 2).

        Points behind the camera are left out.
        """
        p_C = (self.X_CB @ np.transpose(p_B)).T
        p_C = p_C[p_C[:, 2] > _NEAR]
        centre = self.info.center_x(), self.info.center_y()
        return self.info.focal_x() * p_C[:, :2] / p_C[:, 2:] + centre


class FilmScene:
    """Renders the arm, the eraser and the board of a station as a camera sees them.

    The station itself stays as it is: positions are set in a Context of its own.

    Parameters
    ----------
    station : Diagram
        With subsystems plant and scene_graph; the plant has a frame `surface`, B.
    camera : CameraConfig
    size : tuple of int
        Width and height, pixels.
    """

    def __init__(
        self, station: Diagram, camera: CameraConfig, size: tuple[int, int]
    ) -> None:
        plant: Any = station.GetSubsystemByName("plant")
        scene_graph: Any = station.GetSubsystemByName("scene_graph")
        context = station.CreateDefaultContext()
        self._plant, self._scene_graph = plant, scene_graph
        self._plant_context = station.GetMutableSubsystemContext(plant, context)
        self._graph_context = station.GetMutableSubsystemContext(scene_graph, context)
        params = RenderLights()
        params.backend = "EGL"
        engine = MakeRenderEngineVtk(params)
        scene_graph.AddRenderer(self._graph_context, _RENDERER, engine)
        self._surface = plant.GetFrameByName("surface")
        eye = np.array(camera.eye)
        R_WC = RotationMatrix(CameraAxes(eye, np.array(camera.target)))
        self._X_WC = RigidTransform(R_WC, eye)
        width, height = size
        focal = 0.5 * height / np.tan(0.5 * np.deg2rad(FIELD_OF_VIEW))
        self._info = CameraInfo(width, height, focal, focal, width / 2, height / 2)
        core = RenderCameraCore(
            _RENDERER, self._info, ClippingRange(_NEAR, _FAR), RigidTransform()
        )
        self._color = ColorRenderCamera(core, show_window=False)
        self._depth = DepthRenderCamera(core, DepthRange(_NEAR, _FAR))

    def render(self, q: ArrayLike) -> Shot:
        """Render the station with the plant at positions (nq,)."""
        self._plant.SetPositions(self._plant_context, q)
        query = self._scene_graph.get_query_output_port().Eval(self._graph_context)
        world = self._scene_graph.world_frame_id()
        color = query.RenderColorImage(self._color, world, self._X_WC).data
        depth = query.RenderDepthImage(self._depth, world, self._X_WC).data
        X_WB = self._surface.CalcPoseInWorld(self._plant_context)
        return Shot(
            color=np.array(color[..., :3]),
            depth=np.array(depth[..., 0]),
            X_CB=self._X_WC.inverse() @ X_WB,
            info=self._info,
        )
