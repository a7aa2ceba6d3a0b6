"""Pictures of a station: rendered without a screen, with ink, path and caption.

The renderer has no representation of ink. A pixel shows the face of the board if its
point, from the depth image, lies on it. There the colour of the ink multiplies the
pixel's colour, so that light and shadows stay.
"""

import functools
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont
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
from scipy.ndimage import map_coordinates

from fmp_drake.errors import RunError
from fmp_drake.numeric import Array, Mask
from fmp_drake.station.page import FIELD_OF_VIEW, CameraAxes, RenderLights
from fmp_drake.station.scenario_parts import CameraConfig
from fmp_drake.systems import InkGrid
from fmp_drake.systems.ink.mesh import ink_colours
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.surface.surface import project_all

_RENDERER = "film"
_NEAR, _FAR = 0.05, 10.0  # Rendered distances, m.
# Colour of a white board for each remaining fraction of ink, in 255ths.
_SHADES = ink_colours(np.linspace(0, 1, 256), srgb=True).astype(np.float32)
# Distance up to which a pixel's point is on the board, m; the mesh of a curved board
# deviates by half of it.
_TOLERANCE = 4e-4

_TRAIL_COLOR = 255 * np.array([TRAIL_COLOR.r(), TRAIL_COLOR.g(), TRAIL_COLOR.b()])
_TRAIL_SEGMENTS = 12
_MAX_ALPHA = 0.85
_CAPTION_COLOR = "#1D2733"

# Without EGL, VTK ends the process, so a separate process tries it.
_PROBE = """
from pydrake.geometry import (ClippingRange, ColorRenderCamera, MakeRenderEngineVtk,
    RenderCameraCore, RenderEngineVtkParams, SceneGraph)
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo
graph = SceneGraph()
context = graph.CreateDefaultContext()
engine = MakeRenderEngineVtk(RenderEngineVtkParams(backend="EGL"))
graph.AddRenderer(context, "r", engine)
core = RenderCameraCore("r", CameraInfo(4, 4, 1.0), ClippingRange(1, 2), RigidTransform())
graph.get_query_output_port().Eval(context).RenderColorImage(
    ColorRenderCamera(core, False), graph.world_frame_id(), RigidTransform())
"""


class Shot(NamedTuple):
    """Picture of a station at one moment.

    Attributes
    ----------
    color : ndarray of uint8, shape (height, width, 3)
        sRGB.
    depth : ndarray of float32, shape (height, width)
        Distance along the camera's z, m; infinite for the background.
    X_CB : RigidTransform
        The board in the camera's frame.
    info : CameraInfo
        Intrinsic parameters of the camera.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    X_CB: RigidTransform
    info: CameraInfo

    def points(self) -> Array:
        """Return the visible points p_B, those of finite depth, shape (N, 3), m."""
        rows, columns = np.nonzero(np.isfinite(self.depth))
        depth = self.depth[rows, columns].astype(float)
        # VTK puts the centre of pixel (i, j) at (i + 0.5, j + 0.5).
        x = (columns + 0.5 - self.info.center_x()) / self.info.focal_x()
        y = (rows + 0.5 - self.info.center_y()) / self.info.focal_y()
        p_C = depth * np.stack([x, y, np.ones_like(x)])
        return (self.X_CB.inverse() @ p_C).T.copy()

    def pixels(self, p_B: ArrayLike) -> Array:
        """Return column and row of points p_B (N, 3) in the picture, shape (N, 2).

        Points behind the camera are omitted.
        """
        p_C = (self.X_CB @ np.transpose(p_B)).T
        p_C = p_C[p_C[:, 2] > _NEAR]
        centre = self.info.center_x(), self.info.center_y()
        return self.info.focal_x() * p_C[:, :2] / p_C[:, 2:] + centre


class FilmScene:
    """Renderer of the arm, the eraser and the board of a station, seen by a camera.

    It sets positions in a Context of its own; the station is not changed.

    Parameters
    ----------
    station : Diagram
        With subsystems plant and scene_graph; the plant has a frame `surface`, B.
    camera : CameraConfig
    size : tuple of int
        Width and height, pixels.

    Raises
    ------
    RunError
        If the renderer cannot draw a mesh.
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
        try:
            scene_graph.AddRenderer(self._graph_context, _RENDERER, engine)
        except RuntimeError as error:
            raise RunError(
                f"the scene cannot be drawn: {error}. Correct the mesh; a model "
                "needs no <visual>."
            ) from None
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


def paint_ink(shot: Shot, grid: InkGrid, ink: ArrayLike) -> Mask:
    """Paint ink into a shot's colours, in place.

    Parameters
    ----------
    shot : Shot
    grid : InkGrid
    ink : array_like of uint8, shape (ny nx,)
        Remaining ink in each cell, 0 for none to 255 for all.

    Returns
    -------
    ndarray of bool, shape (height, width)
        Pixels that show the face of the board.
    """
    visible = np.isfinite(shot.depth)
    uvh = project_all(grid.curvature, shot.points(), np.zeros(2))
    cells = (uvh[:, :2] - grid.corner) / grid.pitch
    is_face = np.all((cells >= 0) & (cells <= grid.shape[::-1]), axis=1)
    is_face &= np.abs(uvh[:, 2]) < _TOLERANCE
    visible[visible] = is_face
    # Interpolate between the centres of cells, and extend the outermost as constants.
    remaining_ink = map_coordinates(
        np.reshape(ink, grid.shape).astype(np.float32),
        cells[is_face, ::-1].T - 0.5,
        order=1,
        mode="nearest",
    )
    shades = _SHADES[np.rint(remaining_ink).astype(np.uint8)]
    shot.color[visible] = np.rint(shot.color[visible] * shades).astype(np.uint8)
    return visible


def paint_trail(
    color: NDArray[np.uint8],
    pixels: Array,
    *,
    where: Mask,
) -> None:
    """Draw a line into a picture, in place, fading towards its start.

    Parameters
    ----------
    color : ndarray of uint8, shape (height, width, 3)
    pixels : ndarray, shape (k, 2)
        Columns and rows of its points.
    where : ndarray of bool, shape (height, width)
        The pixels that may be painted.
    """
    height, width = where.shape
    mask = Image.new("L", (width, height))
    draw = ImageDraw.Draw(mask)
    thickness = max(1, round(height / 220))
    segments = np.array_split(np.arange(len(pixels)), _TRAIL_SEGMENTS)
    for number, segment in enumerate(segments, start=1):
        if len(segment):
            points = pixels[segment[0] : segment[-1] + 2]
            shade = round(255 * _MAX_ALPHA * number / _TRAIL_SEGMENTS)
            draw.line([*map(tuple, points)], fill=shade, width=thickness, joint="curve")
    alpha = np.asarray(mask)[where, np.newaxis] / 255
    color[where] = np.rint((1 - alpha) * color[where] + alpha * _TRAIL_COLOR)


def draw_caption(picture: Image.Image, text: str) -> None:
    """Draw lines of text into a picture, at its lower left."""
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    size, margin = max(8, picture.height // 30), max(4, picture.height // 40)
    font = ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size)
    draw = ImageDraw.Draw(picture)
    width = draw.textbbox((0, 0), text, font=font)[2]
    if width > (most := picture.width - 2 * margin):
        font = font.font_variant(size=max(1, int(size * most / width)))
    position = (margin, picture.height - margin)
    draw.text(position, text, anchor="ld", font=font, fill=_CAPTION_COLOR)


def check_renderer() -> None:
    """Raise an error if EGL does not work."""
    if not renders():
        raise RunError(
            "films are rendered through EGL, which does not work here; install it "
            "(on Ubuntu and Debian: apt-get install libegl1 libgl1-mesa-dri)."
        )


@functools.cache
def renders() -> bool:
    """Return whether this machine renders through EGL."""
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE],
            capture_output=True,
            timeout=120,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return probe.returncode == 0
