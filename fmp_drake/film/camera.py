"""Where the camera of a film stands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import ClippingRange, RenderCameraCore
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number


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

    eye: Sequence[float] = (1.45, -0.80, 0.88)
    target: Sequence[float] = (0.38, 0.0, 0.20)
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
