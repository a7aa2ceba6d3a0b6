"""Ink of a board, painted into a rendered picture.

The renderer has no representation of ink. A pixel shows the face of the board where its
depth is that of the plane z_B = 0, or of a curved face; there the ink is looked up and multiplied with the
pixel's colour, so that light and shadows stay.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from scipy.ndimage import map_coordinates

from fmp_drake.errors import RunError
from fmp_drake.film.scene import Shot
from fmp_drake.numeric import finite_array
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import ink_colours
from fmp_drake.systems.surface.surface import project_all

type FloatImage = NDArray[np.float32]

# Colours of ink on a white board by the fraction that is left, in 255ths.
_SHADES = ink_colours(np.linspace(0, 1, 256), srgb=True).astype(np.float32)

# Of a pixel's depth to the plane, m; the renderer's own error is below 1e-6.
_TOLERANCE = 2e-4
# Of a pixel to a curved board, m, whose mesh deviates by up to half of it.
_CURVED_TOLERANCE = 4e-4


class _Face(NamedTuple):
    """Pixels whose rays intersect the grid, for one pose of the board.

    `pixels` are flat indices (n,), `depth` (n,) that of the plane, and `cells` (2, n)
    row and column of the grid, real numbers that are whole at the centres of cells.
    """

    pixels: NDArray[np.intp]
    depth: FloatImage
    cells: FloatImage


class BoardPaint:
    """Paints ink on the face of a board; stores its pixels until the board moves.

    Parameters
    ----------
    grid : InkGrid
    rays : ndarray, shape (3, height, width)
        Through the pixels, in the camera's frame; z is 1.
    """

    def __init__(self, grid: InkGrid, *, rays: FloatImage) -> None:
        self._grid = grid
        self._rays = rays
        self._pose: NDArray[np.float64] | None = None
        self._face: _Face | None = None

    def paint(self, shot: Shot, ink: ArrayLike) -> NDArray[np.bool_]:
        """Paint ink into a shot's colours, in place.

        Parameters
        ----------
        shot : Shot
        ink : array_like, shape (ny, nx)
            Fraction of the ink that is left, from 0 to 1.

        Returns
        -------
        ndarray of bool, shape (height, width)
            Pixels that show the face of the board.
        """
        values = finite_array(
            ink, "the ink of a frame", self._grid.shape, error=RunError
        ).astype(np.float32)
        visible = np.zeros(shot.depth.shape, dtype=bool)
        if self._grid.curvature.is_plane:
            face = self._face_at(shot.X_CB)
        else:
            face = _find_curved_face(self._grid, self._rays, shot)
        near = np.abs(shot.depth.ravel()[face.pixels] - face.depth) < _TOLERANCE
        pixels = face.pixels[near]
        visible.ravel()[pixels] = True
        # Between the centres of cells, and constant beyond the outermost.
        left = map_coordinates(values, face.cells[:, near], order=1, mode="nearest")
        shades = _SHADES[np.rint(255 * left).astype(np.uint8)]
        colors = shot.color.reshape(-1, 3)
        colors[pixels] = np.rint(colors[pixels] * shades).astype(np.uint8)
        return visible

    def _face_at(self, X_CB: RigidTransform) -> _Face:
        pose = X_CB.GetAsMatrix34()
        if self._face is None or self._pose is None or np.any(pose != self._pose):
            self._face = _find_face(self._grid, self._rays, X_CB)
            self._pose = pose
        return self._face


def _find_face(grid: InkGrid, rays: FloatImage, X_CB: RigidTransform) -> _Face:
    """Intersect the pixels' rays with the plane of the board."""
    X_BC = X_CB.inverse()
    R, p = X_BC.rotation().matrix().astype(np.float32), X_BC.translation()
    flat = rays.reshape(3, -1)
    with np.errstate(divide="ignore"):
        depth = -np.float32(p[2]) / (R[2] @ flat)
    # The face is visible from the front only.
    pixels = np.flatnonzero(np.isfinite(depth) & (depth > 0) & (p[2] > 0))
    depth = depth[pixels]
    xy = p[:2, None] + depth * (R[:2] @ flat[:, pixels])
    at = (xy - grid.corner[:, None]) / grid.pitch[:, None]
    limit = np.array(grid.shape[::-1])[:, None]
    inside = np.all((at >= 0) & (at <= limit), axis=0)
    pixels, depth = pixels[inside], depth[inside]
    return _Face(
        pixels=pixels,
        depth=depth.astype(np.float32),
        cells=(at[::-1, inside] - 0.5).astype(np.float32),
    )


def _find_curved_face(grid: InkGrid, rays: FloatImage, shot: Shot) -> _Face:
    """Find the pixels of a curved board by their depth."""
    X_BC = shot.X_CB.inverse()
    depth = shot.depth.ravel()
    pixels = np.flatnonzero(np.isfinite(depth))
    p_C = rays.reshape(3, -1)[:, pixels] * depth[pixels]
    p_B = p_C.T.astype(float) @ X_BC.rotation().matrix().T + X_BC.translation()
    uvh = project_all(grid.curvature, p_B, np.zeros(2))
    at = (uvh[:, :2] - grid.corner) / grid.pitch
    inside = np.all((at >= 0) & (at <= grid.shape[::-1]), axis=1)
    inside &= np.abs(uvh[:, 2]) < _CURVED_TOLERANCE
    return _Face(
        pixels=pixels[inside],
        depth=depth[pixels[inside]],
        cells=(at[inside, ::-1].T - 0.5).astype(np.float32),
    )
