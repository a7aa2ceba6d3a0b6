"""Headless Chromium, for the tests of pages."""

import base64
import fcntl
import io
import itertools
import json
import os
import select
import shutil
import signal
import subprocess
import time

import matplotlib.image
import numpy as np
import pytest
from pydrake.math import RigidTransform

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="Chromium is not installed"
)

# A proxy that nobody answers, and no name resolves: what a page without network sees.
OFFLINE = ("--proxy-server=127.0.0.1:9", "--host-resolver-rules=MAP * ~NOTFOUND")

CTRL, SHIFT = 2, 8

PANEL = 256
"""Width of the panel beside the scene, pixels."""

# How long a page may take, s, and how often it is tried.
_PATIENCE, _TRIES = 45.0, 4

# The pixel of the middle of what is drawn at a path, given as a list of names.
_CENTRE = """(() => {
  let node = viewer.scene_tree;
  for (const name of %s) { node = node.children[name]; if (!node) return null; }
  let any = false;
  node.object.traverse((o) => { any = any || o.isMesh; });
  if (!any) return null;
  viewer.scene.updateMatrixWorld(true);
  const p = new THREE.Box3().setFromObject(node.object).getCenter(new THREE.Vector3());
  p.project(viewer.camera);
  const r = viewer.renderer.domElement.getBoundingClientRect();
  return [r.left + (p.x + 1) / 2 * r.width, r.top + (1 - p.y) / 2 * r.height];
})()"""

# Without a graphics card a frame takes 0.3 s of a core, from the simulation that it shows;
# half of them are for shadows.
_DRAW_SELDOM = """(() => {
  const draw = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (f) => setTimeout(() => draw((time) => {
    if (typeof viewer !== "undefined") viewer.renderer.shadowMap.enabled = false;
    f(time);
  }), 200);
  const get = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    return get.call(this, kind, {...options, antialias: false});
  };
})()"""

# A saved page fetches each of its messages by itself, and they arrive in any order.
_COUNT_FETCHES = """(() => {
  const fetch = window.fetch.bind(window);
  window.fetchesLeft = 0;
  window.fetch = async (...what) => {
    window.fetchesLeft += 1;
    try {
      const answer = await fetch(...what);
      return new Response(await answer.arrayBuffer(), answer);
    } finally { setTimeout(() => { window.fetchesLeft -= 1; }); }
  };
})()"""

# Meshes are loaded after their message was read, and have properties pending until then.
_SCENE_IS_COMPLETE = """(() => {
  const loads = (node) =>
    node.pending_properties !== null || Object.values(node.children).some(loads);
  return fetchesLeft === 0 && !viewer.animator.playing && !loads(viewer.scene_tree);
})()"""

# A frame that is finished when the promise is kept, also where drawing lags behind.
_DRAW = """new Promise((done) => requestAnimationFrame(() => {
  if (typeof viewer !== "undefined") {
    viewer.render();
    const gl = viewer.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }
  done();
}))"""

_marks = itertools.count()

_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--no-first-run",
)


def open_page(url, folder, *options, milliseconds=5000):
    """Open a page for some of its own time, and return what Chromium printed.

    Now and then a page's own time stands still and Chromium never ends, whatever the
    page: then it is opened once more.
    """
    for tries in range(_TRIES):
        command = [
            CHROMIUM,
            *_OPTIONS,
            f"--user-data-dir={folder / f'profile_{tries}'}",
            f"--virtual-time-budget={milliseconds}",
            *options,
            url,
        ]
        # A group of its own: Chromium's children hold its output open.
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, start_new_session=True
        ) as process:
            try:
                printed, _ = process.communicate(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                continue
        assert process.returncode == 0, f"Chromium ended with {process.returncode}"
        return printed
    raise TimeoutError(f"Chromium did not end with {url} within {_PATIENCE} s.")


def screenshot(url, folder, *options, size=(800, 500)):
    """Return a picture of a page, shape (height, width, 3), from 0 to 1."""
    path = folder / "screenshot.png"
    width, height = size
    open_page(
        url,
        folder,
        "--hide-scrollbars",
        f"--window-size={width},{height}",
        f"--screenshot={path}",
        *options,
    )
    return matplotlib.image.imread(path)[..., :3]


class Page:
    """A page in a running Chromium, with a mouse, a keyboard and a JavaScript console.

    It speaks the DevTools protocol through a pair of pipes. A context manager: leaving
    it ends the browser.

    Parameters
    ----------
    url : str
    folder : Path
        For the browser's profile.
    *options : str
        Of the browser.
    size : tuple of 2 ints
        Width and height of the picture.
    timeout : float
        Longest wait for an answer, s.
    seldom : bool
        Draw at most 5 frames per second, without shadows.
    has_touch : bool
        A phone or tablet, with fingers instead of a mouse.
    """

    def __init__(
        self,
        url,
        folder,
        *options,
        size=(800, 500),
        timeout=60.0,
        seldom=True,
        has_touch=False,
    ):
        self._timeout, self._has_touch = timeout, has_touch
        self._scripts = [_DRAW_SELDOM, _COUNT_FETCHES][0 if seldom else 1 :]
        self._number = 0
        self._unread = b""
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        # Away from 3 and 4, on which Chromium reads and writes.
        high = [fcntl.fcntl(f, fcntl.F_DUPFD, 10) for f in (theirs_in, theirs_out)]
        quiet = os.open(os.devnull, os.O_RDWR)
        self._process = os.posix_spawn(
            CHROMIUM,
            [
                CHROMIUM,
                *_OPTIONS,
                "--remote-debugging-pipe",
                "--hide-scrollbars",
                f"--user-data-dir={folder / 'live_profile'}",
                *options,
                "about:blank",
            ],
            os.environ,
            file_actions=[
                *((os.POSIX_SPAWN_DUP2, quiet, i) for i in (0, 1, 2)),
                *((os.POSIX_SPAWN_DUP2, high[i], 3 + i) for i in (0, 1)),
                *((os.POSIX_SPAWN_CLOSE, f) for f in high),
            ],
            setpgroup=0,
        )
        for f in (*high, theirs_in, theirs_out, quiet):
            os.close(f)
        self._in, self._out = ours_in, ours_out
        self._size, self._session, self._context = size, None, None
        try:
            self.go(url)
        except BaseException:
            self.close()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def go(self, url):
        """Open another page in the same browser.

        It closes the connections of the one before, for which a Meshcat that is freed
        would wait ten seconds.
        """
        before, self._session = self._context, None
        if before is not None:
            self.call("Target.disposeBrowserContext", browserContextId=before)
        self._context = self.call("Target.createBrowserContext")["browserContextId"]
        target = self.call(
            "Target.createTarget", url="about:blank", browserContextId=self._context
        )
        attached = self.call("Target.attachToTarget", flatten=True, **target)
        self._session = attached["sessionId"]
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=self._size[0],
            height=self._size[1],
            deviceScaleFactor=1,
            mobile=self._has_touch,
        )
        self.call("Emulation.setTouchEmulationEnabled", enabled=self._has_touch)
        self.call("Page.enable")
        for script in self._scripts:
            self.call("Page.addScriptToEvaluateOnNewDocument", source=script)
        self.call("Page.navigate", url=url)

    def close(self):
        """End the browser."""
        os.close(self._in)
        os.close(self._out)
        # The browser and its other processes: the group that this object began.
        os.killpg(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)

    def call(self, method, **parameters):
        """Call a method of the DevTools protocol and return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + self._timeout
        while True:
            answer = self._read(deadline, method)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]

    def _read(self, deadline, method):
        while b"\0" not in self._unread:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._in], [], [], left)[0]:
                raise TimeoutError(f"Chromium does not answer to {method}")
            chunk = os.read(self._in, 1 << 20)
            if not chunk:
                raise RuntimeError(f"Chromium ended during {method}")
            self._unread += chunk
        answer, self._unread = self._unread.split(b"\0", 1)
        return json.loads(answer)

    def run(self, script):
        """Return the value of a JavaScript expression in the page, or of its promise."""
        result = self.call(
            "Runtime.evaluate",
            expression=script,
            returnByValue=True,
            awaitPromise=True,
        )
        if "exceptionDetails" in result:
            raise RuntimeError(f"{script}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def wait_for(self, script):
        """Wait until a JavaScript expression is true in the page, and return it."""
        deadline = time.monotonic() + self._timeout
        while time.monotonic() < deadline:
            value = self.run(script)
            if value:
                return value
            time.sleep(0.1)
        raise TimeoutError(f"the page never said {script}")

    def wait_for_meshcat(self):
        """Wait until Meshcat's page is connected to its server."""
        self.wait_for(
            "typeof viewer !== 'undefined' && !!viewer.connection && "
            "viewer.connection.readyState === WebSocket.OPEN"
        )

    def wait_for_scene(self, meshcat=None):
        """Wait until all that was sent is loaded, and a recording has been replayed.

        Parameters
        ----------
        meshcat : Meshcat or None
            Whose page this is; None for a saved page.
        """
        if meshcat is not None:
            # Messages keep their order: what was sent before the mark has been read.
            self.wait_for_meshcat()
            mark = f"mark_{next(_marks)}"
            meshcat.SetTransform(f"/{mark}", RigidTransform())
            self.wait_for(f"!!viewer.scene_tree.children['{mark}']")
            meshcat.Delete(f"/{mark}")
        self.wait_for(_SCENE_IS_COMPLETE)

    def centre(self, *names):
        """Return the pixel of the middle of what is drawn at a path, come to rest."""
        last, deadline = None, time.monotonic() + self._timeout
        while time.monotonic() < deadline:
            new = self.wait_for(_CENTRE % list(names))
            if new == last:
                return new
            last = new
            time.sleep(0.5)
        raise TimeoutError(f"{names} goes on moving")

    def mouse(self, kind, x, y, *, pressed=True, modifiers=0):
        """Send a mouse event: pressed, moved or released, at a pixel."""
        self.call(
            "Input.dispatchMouseEvent",
            type=f"mouse{kind.capitalize()}",
            x=x,
            y=y,
            button="left" if pressed else "none",
            buttons=1 if pressed and kind != "released" else 0,
            clickCount=0 if kind == "moved" else 1,
            modifiers=modifiers,
        )

    def grab(self, *names):
        """Press with Ctrl on what is drawn at a path, and return the pixel.

        A busy page shows a body where it was a while ago: press until it is caught.
        """
        deadline = time.monotonic() + self._timeout
        while time.monotonic() < deadline:
            at = self.centre(*names)
            self.mouse("moved", *at, pressed=False, modifiers=CTRL)
            self.mouse("pressed", *at, modifiers=CTRL)
            if (self.run("mouseDrag.path") or "").startswith("/" + "/".join(names)):
                return at
            self.mouse("released", *at, modifiers=CTRL)
            time.sleep(0.5)
        raise TimeoutError(f"{names} cannot be grabbed")

    def touch(self, kind, *at):
        """Send an event of one finger: Start, Move or End, the last without a pixel."""
        points = [{"x": at[0], "y": at[1]}] if at else []
        self.call("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=points)

    def tap(self, x, y):
        """Tap with a finger at a pixel."""
        self.touch("Start", x, y)
        self.touch("End")

    def drag(self, start, end, *, modifiers=0, steps=5):
        """Move from a pixel to another with the button pressed, without a release."""
        for i in range(1, steps + 1):
            x, y = (a + i / steps * (b - a) for a, b in zip(start, end, strict=True))
            self.mouse("moved", x, y, modifiers=modifiers)

    def click(self, x, y):
        """Click at a pixel."""
        self.mouse("moved", x, y, pressed=False)
        self.mouse("pressed", x, y)
        self.mouse("released", x, y)

    def picture(self):
        """Return a picture of the page, shape (height, width, 3), from 0 to 1."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return matplotlib.image.imread(io.BytesIO(base64.b64decode(data)))[..., :3]

    def settled_picture(self):
        """Return a picture, as `picture` does, when a frame was drawn without a change."""
        last, deadline = None, time.monotonic() + self._timeout
        while time.monotonic() < deadline:
            self.run(_DRAW)
            new = self.picture()
            if last is not None and np.array_equal(new, last):
                return new
            last = new
        raise TimeoutError("the page goes on changing")
