"""A page without a browser: what Meshcat's page says while somebody drags a body."""

import numpy as np
import umsgpack

# Of the page's world, whose y is up.
_TO_PAGE = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


class PageMouse:
    """The mouse on a page with pictures at a rate, some time after what they show.

    Parameters
    ----------
    meshcat : Meshcat
    pose : callable
        Returns X_WB of a body of the simulation now, by its name as in `eraser/eraser`.
    eye, target : array_like, shape (3,)
        Of the page's camera, m.
    tracked : bool
        Whether the page tells where its camera is.
    """

    def __init__(self, meshcat, pose, *, eye, target, tracked=True):
        self._meshcat, self._pose = meshcat, pose
        self.eye = np.array(eye, dtype=float)
        self._look = np.array(target, dtype=float) - self.eye
        self._look /= np.linalg.norm(self._look)
        self._name = None
        if tracked:
            z = -self._look
            x = np.cross([0.0, 0.0, 1.0], z)
            x /= np.linalg.norm(x)
            X = np.eye(4)
            X[:3, :3] = _TO_PAGE @ np.column_stack([x, np.cross(z, x), z])
            X[:3, 3] = _TO_PAGE @ self.eye
            self._say(
                type="camera_pose",
                camera_pose=X.T.ravel().tolist(),
                is_perspective=True,
            )

    def _say(self, **message):
        self._meshcat._InjectWebsocketMessage(umsgpack.packb(message))

    def press(self, name, point):
        """Grab a body at a point in W."""
        self._name, self._hit = name, np.array(point, dtype=float)
        self._picked = self._pose(name).inverse().multiply(self._hit)
        self.frame(self._hit)

    def frame(self, over, pose=None):
        """Draw a picture, with the cursor over a point in W."""
        ray = np.array(over, dtype=float) - self.eye
        depth = (self._hit - self.eye) @ self._look
        cursor = self.eye + ray * depth / (ray @ self._look)
        self.send((pose or self._pose(self._name)).multiply(self._picked), cursor)

    def send(self, anchor, cursor):
        """Send what a page says."""
        self._say(
            type="mouse_drag",
            name=f"/drake/bodies/{self._name}/visual/<object>",
            drag_anchor=list(map(float, anchor)),
            drag_target=list(map(float, cursor)),
        )

    def release(self):
        """Let the button go."""
        self._say(type="mouse_drag", name="", drag_anchor=[], drag_target=[])
