"""The messages of Meshcat's page while somebody drags a body, without a browser."""

from collections import deque

import numpy as np
import umsgpack
from pydrake.geometry import Meshcat

from fmp_drake.runs import TeachingSession
from fmp_drake.station import MouseOnPage
from fmp_drake.systems import PagePanel

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


def _waves(theta, amplitude, harmonics):
    """Return a rounded wave of amplitude 1: sines of odd harmonics."""
    wave = sum(amplitude(n) * np.sin(n * theta) for n in harmonics)
    return wave / sum(amplitude(n) * np.sin(n * np.pi / 2) for n in harmonics)


def _triangle(theta):
    return _waves(theta, lambda n: (-1) ** (n // 2) / n**2, (1, 3, 5))


def _edge(theta):
    return _waves(theta, lambda n: np.sin(n * np.pi / 4) / n**2, (1, 3, 5))


# x and y over the phase, rad, m.
SHAPES = {
    "eight": lambda p: (0.06 * np.sin(2 * p), 0.12 * np.sin(p)),
    "circle": lambda p: (0.09 * np.sin(p), 0.09 * np.cos(p)),
    "zigzag": lambda p: (0.05 * _triangle(3 * p), 0.13 * _triangle(p)),
    "square": lambda p: (0.08 * _edge(p), 0.10 * _edge(p + np.pi / 2)),
}
PERIODS = {"eight": 5.0, "circle": 4.0, "zigzag": 6.0, "square": 6.0}


class TaughtSession:
    """A teaching session whose arm is dragged by a `PageMouse`, without a browser.

    Parameters
    ----------
    scenario : Scenario
    frames : float
        Pictures of the page in a second.
    latency : float
        How old what they show is, s.
    eye : array_like, optional
        Of the page's camera, m; the scenario's by default.
    panel : bool
        Whether there is a page with a panel, whose mouse pulls while it plays.
    """

    def __init__(self, scenario, *, frames=60.0, latency=0.05, eye=None, panel=False):
        self.meshcat = Meshcat()
        self.scenario, self.frames, self.latency = scenario, frames, latency
        self.panel = PagePanel(self.meshcat) if panel else None
        self.session = TeachingSession(
            scenario, MouseOnPage(self.meshcat), clock=None, panel=self.panel
        )
        camera = scenario.camera
        self.mouse = PageMouse(
            self.meshcat,
            self.pose,
            eye=camera.eye if eye is None else eye,
            target=camera.target,
        )
        self.R_WB = scenario.board.pose().rotation().matrix()
        self.worst = {}
        self.cursor = []
        self.watch()

    @property
    def simulator(self):
        return self.session.simulator

    @property
    def now(self):
        return self.simulator.get_context().get_time()

    @property
    def station(self):
        """The station of this mode; that of a run is in a diagram with loggers."""
        system = self.simulator.get_system()
        for name in ("wiping_station", "following_station"):
            if system.HasSubsystemNamed(name):
                return system.GetSubsystemByName(name)
        return system

    def pose(self, name):
        """Return X_WB of a body, as in `eraser/eraser`."""
        plant = self.station.GetSubsystemByName("plant")
        context = plant.GetMyContextFromRoot(self.simulator.get_context())
        model, body = name.split("/")
        instance = plant.GetModelInstanceByName(model)
        return plant.GetBodyByName(body, instance).EvalPoseInWorld(context)

    def tip(self):
        """Return p_BE, as the station says."""
        station = self.station
        context = station.GetMyContextFromRoot(self.simulator.get_context())
        led = station.HasOutputPort("position")
        port = station.GetOutputPort("position" if led else "measured_position")
        return np.array(port.Eval(context))

    def watch(self):
        """Keep the largest used fractions of the arm's limits, at every step."""
        station = self.simulator.get_system()
        plant = station.GetSubsystemByName("plant")
        low, high = (
            plant.GetPositionLowerLimits()[:7],
            plant.GetPositionUpperLimits()[:7],
        )
        middle, half = (low + high) / 2, (high - low) / 2
        limits = {
            "speed": plant.GetVelocityUpperLimits()[:7],
            "torque": plant.GetEffortUpperLimits()[:7],
        }
        ports = [station.GetOutputPort(name) for name in ("state", "actuation")]

        def look(root):
            context = station.GetMyContextFromRoot(root)
            state, torque = (port.Eval(context) for port in ports)
            for name, value in {
                "range": (state[:7] - middle) / half,
                "speed": state[7:] / limits["speed"],
                "torque": torque / limits["torque"],
            }.items():
                most = float(np.abs(value).max())
                self.worst[name] = max(self.worst.get(name, 0.0), most)

        self.simulator.set_monitor(look)

    def press(self, name="eraser/eraser", lift=(0.0, 0.0, 0.02)):
        """Grab a body a little above its frame."""
        self.hit = self.pose(name).translation() + lift
        self.mouse.press(name, self.hit)
        self.name, self.start, self.from_tip = name, self.now, self.tip()
        self.poses = deque([(self.now, self.pose(name))])

    def frame(self, way):
        """Show a picture, with the cursor moved (x, y) over the board since the press."""
        over = self.hit + self.R_WB @ [*way, 0.0]
        self.cursor.append((self.now, *way))
        self.poses.append((self.now, self.pose(self.name)))
        while len(self.poses) > 1 and self.poses[1][0] <= self.now - self.latency:
            self.poses.popleft()
        self.mouse.frame(over, self.poses[0][1])
        self.session.advance(1 / self.frames)

    def drag(self, shape, seconds, *, size=1.0, tempo=1.0):
        """Drag along a shape for some time, without letting go."""
        for i in range(round(seconds * self.frames)):
            t = i / self.frames
            phase = 2 * np.pi * t * tempo / PERIODS[shape]
            way = size * np.array(SHAPES[shape](phase))
            self.frame((1 - np.exp(-t / 0.5)) * way)

    def release(self):
        """Let go, and wait."""
        self.mouse.release()
        self.session.advance(0.3)

    def recording_error(self, *, settle=2.0):
        """Return the rms of the only demonstration from the cursor's path, after its lag, m."""
        (shown,) = self.session.demonstrations
        cursor = np.array(self.cursor)
        time, path = shown.time, shown.values[:, :2] - self.from_tip[:2]
        kept = (time > settle) & (time < time[-1] - 0.5)

        def rms(begin):
            at = time[kept] + begin
            way = [np.interp(at, cursor[:, 0], cursor[:, i]) for i in (1, 2)]
            return np.sqrt(np.mean(np.sum((path[kept] - np.transpose(way)) ** 2, 1)))

        # When the recording began is not known: what was still is cut off.
        begins = self.start + np.arange(-0.5, 1.0, 0.005)
        return min(rms(begin) for begin in begins)
