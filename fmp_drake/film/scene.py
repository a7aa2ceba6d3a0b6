"""The camera of a film, and renderings of a station: colours and depths."""

from collections.abc import Sequence
from dataclasses import dataclass
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

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number, finite_array
from fmp_drake.station.page.stage import RenderLights

_RENDERER = "film"


@dataclass(frozen=True, kw_only=True)
class FilmCamera:
    """A camera C that looks at a point, upright; z of C looks ahead, y down.

    Attributes
    ----------
    eye, target : sequence of 3 floats
        p_WC and the point looked at, in W, m.
    fov_y : float
        Vertical field of view, rad.

    Examples
    --------
    >>> camera = FilmCamera(eye=(1.0, -1.0, 1.0), target=(0.4, 0.0, 0.2))
    >>> camera.pose().translation()
    array([ 1., -1.,  1.])
    """

    eye: Sequence[float]
    target: Sequence[float]
    fov_y: float = 0.7

    def pose(self) -> RigidTransform:
        """Return the pose X_WC of the camera in the world.

        Raises
        ------
        RunError
            Where the camera looks straight up or down, or at itself.
        """
        eye, target = (np.array(p, dtype=float) for p in (self.eye, self.target))
        z = target - eye
        x = np.cross(z, [0.0, 0.0, 1.0])
        if not np.linalg.norm(x) > 1e-6 * np.linalg.norm(z):
            raise RunError(
                f"the camera at {self.eye} m looks at {self.target} m; it must not "
                "look straight up or down, or at itself."
            )
        z, x = z / np.linalg.norm(z), x / np.linalg.norm(x)
        return RigidTransform(
            RotationMatrix(np.column_stack([x, np.cross(z, x), z])), eye
        )

    def core(self, renderer: str, size: tuple[int, int]) -> RenderCameraCore:
        """Return Drake's camera of a renderer, for pictures (width, height)."""
        check_number(
            self.fov_y, "fov_y", above=0.01, below=3.0, unit="rad", error=RunError
        )
        width, height = size
        focal = 0.5 * height / np.tan(0.5 * self.fov_y)
        info = CameraInfo(width, height, focal, focal, width / 2, height / 2)
        return RenderCameraCore(
            renderer, info, ClippingRange(0.05, 10.0), RigidTransform()
        )


def pixel_rays(core: RenderCameraCore) -> NDArray[np.float32]:
    """Return the rays through the pixels' centres in C, (3, height, width); z is 1.

    VTK puts the centre of pixel (i, j) at (i + 0.5, j + 0.5), which agrees with its
    depth pictures to 0.3 micrometres.
    """
    info = core.intrinsics()
    u = (np.arange(info.width()) + 0.5 - info.center_x()) / info.focal_x()
    v = (np.arange(info.height()) + 0.5 - info.center_y()) / info.focal_y()
    x, y = np.meshgrid(u, v)
    return np.stack([x, y, np.ones_like(x)]).astype(np.float32)


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
