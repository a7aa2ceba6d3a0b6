"""Background, lights and camera of the page and of films."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import LightParameter, Meshcat, RenderEngineVtkParams, Rgba

from fmp_drake.errors import StationError
from fmp_drake.numeric import finite_array

FIELD_OF_VIEW = 40.0  # Of the page's camera, vertical, degrees.
_SKY = (0.93, 0.945, 0.96)
_GROUND = (0.80, 0.82, 0.85)
# Direction of the key light in the camera's axes: right, down, away from it.
_KEY = np.array([0.50, 0.75, 0.80]) / np.linalg.norm([0.50, 0.75, 0.80])
_KEY_DISTANCE = 3.4  # From the robot's base, m.
_ON = "/<object>"


def SetStage(meshcat: Meshcat, *, eye: ArrayLike, target: ArrayLike) -> None:
    """Light a page and place its camera.

    The background is bright, without grid and axes. One lamp above the viewer's left
    shoulder casts soft shadows; the other light is weak and ambient. The lamp stays fixed
    when a user rotates the view.

    Parameters
    ----------
    meshcat : Meshcat
    eye, target : array_like, shape (3,)
        Position of the camera, and point in the middle of its view, in the world, m.

    Raises
    ------
    StationError
        If the direction of the view is undefined or vertical.
    """
    eye, target = (
        finite_array(point, f"the camera's {name}", (3,), error=StationError)
        for name, point in (("eye", eye), ("target", target))
    )
    R_WC = CameraAxes(eye, target)
    meshcat.SetProperty("/Background", "top_color", list(_SKY))
    meshcat.SetProperty("/Background", "bottom_color", list(_GROUND))
    # The background also illuminates the arm's meshes, here less than the ambient light.
    meshcat.SetProperty("/", "environmentIntensity", 0.15)
    for name in (
        "/Grid",
        "/Axes",
        "/Lights/PointLightNegativeX",
        "/Lights/PointLightPositiveX",
    ):
        meshcat.SetProperty(name, "visible", False)

    meshcat.SetProperty("/Lights/SpotLight", "visible", True)
    key = "/Lights/SpotLight" + _ON
    meshcat.SetProperty(key, "position", list(-_KEY_DISTANCE * (R_WC @ _KEY)))
    for name, value in (
        ("intensity", 58.0),  # cd
        ("angle", 0.42),  # rad
        ("penumbra", 1.0),
        ("shadow.mapSize.width", 2048.0),
        ("shadow.mapSize.height", 2048.0),
        ("shadow.radius", 3.0),
        ("shadow.bias", -0.0004),
        ("shadow.normalBias", 0.02),
    ):
        meshcat.SetProperty(key, name, value)
    meshcat.SetProperty(key, "castShadow", True)
    meshcat.SetProperty("/Lights/AmbientLight" + _ON, "intensity", 0.65)
    fill = "/Lights/FillLight" + _ON
    meshcat.SetProperty(fill, "position", list(R_WC @ [1.0, -0.2, -0.6]))
    meshcat.SetProperty(fill, "intensity", 0.35)

    camera = Meshcat.PerspectiveCamera(
        fov=FIELD_OF_VIEW, aspect=1.5, near=0.05, far=50.0
    )
    meshcat.SetCamera(camera)
    meshcat.SetCameraPose(eye, target)


def RenderLights() -> RenderEngineVtkParams:
    """Return the parameters of a VTK renderer whose pictures look like the page.

    The lamps are fixed to the camera, at a distance of 1 m to 3 m. Two lamps replace the key
    light, and only one of them casts shadows. VTK's shadow maps darken patches of round
    surfaces towards the lamp, which is less visible with two lamps. The caller sets the
    backend.

    Returns
    -------
    RenderEngineVtkParams
    """
    place = np.array([0.0, 0.0, 1.9]) - _KEY_DISTANCE * _KEY
    lamps = [
        _Lamp(place, 1.75),
        _Lamp(np.array([2.0, -0.4, 0.0]), 0.8),
        _Lamp(np.array([-1.5, -1.0, 0.0]), 0.5),
        _Lamp(np.array([0.0, 2.0, 2.0]), 0.35),
    ]
    key = _Lamp(place, 1.35)
    key.type = "spot"
    key.direction = _KEY
    key.cone_angle = 24.0
    return RenderEngineVtkParams(
        lights=[key, *lamps],
        default_clear_color=np.array(_SKY),
        cast_shadows=True,
        shadow_map_size=1024,
    )


def _Lamp(position: np.ndarray, intensity: float) -> LightParameter:
    return LightParameter(
        type="point",
        frame="camera",
        color=Rgba(1, 1, 1),
        intensity=intensity,
        position=position,
    )


def CameraAxes(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return R_WC, with the right, down and forward axes of the camera as columns."""
    forward = target - eye
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        raise StationError(
            f"the camera at {eye} looks straight up or down at {target}; move its eye "
            "a little to the side."
        )
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward])
