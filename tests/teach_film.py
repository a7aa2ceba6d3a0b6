"""Make the film and the picture at the top of the README, on the real pages.

    python tests/teach_film.py examples/teaching.webp   # teach, learn, wipe
    python tests/teach_film.py examples/page.png        # the page of `wipe`

A synthetic mouse drags and clicks in headless Chromium. Simulation and page wait for each
other at every frame, so that a slow renderer changes nothing; how much faster than
real time the film runs is written in it.
"""

import base64
import io
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from browser import Page
from PIL import Image

from fmp_drake.apps.page import open_page
from fmp_drake.runs import TeachingSession, WipingRun
from fmp_drake.runs.simulation_loop import RunButtons
from fmp_drake.runs.teach_page import TeachPage
from fmp_drake.skills.learning import scenario_skill
from fmp_drake.station import LoadScenario, MouseOnPage

SIZE, FPS = (760, 475), 10
QUALITY = 30
# Of the dragged movement: seconds of a cycle, half of its extent over x and y, and how
# far in front of the grasp its middle is, m.
PERIOD, EXTENT, AHEAD = 8.0, (0.07, 0.15), 0.05
SHOWN, PLAYED = 26.0, 17.0
# Pictures of the page in a simulated second of dragging.
LOOKS = 20
# The whole arm, which hides little of the board.
EYE, TARGET = [1.55, 0.42, 1.05], [0.45, 0.0, 0.26]
# Pixels at which the mouse begins, and where it hides nothing.
BEGIN, ASIDE = (570, 400), (236, 455)

# The mouse's cursor, which a screenshot leaves out, and a line of words.
OVERLAY = """
const add = (style) => {
  const element = document.body.appendChild(document.createElement("div"));
  element.style = "position: fixed; pointer-events: none; z-index: 9;" + style;
  return element;
};
const words = add(`left: 274px; bottom: 14px; padding: 7px 14px; border-radius: 8px;
  background: #1d2733e0; color: #fff; font: 600 17px system-ui, "DejaVu Sans", sans-serif;`);
const speed = add(`right: 16px; bottom: 20px; color: #1d2733;
  font: 600 15px system-ui, "DejaVu Sans", sans-serif;`);
const cursor = add("left: 0; top: 0;");
cursor.innerHTML = `<svg width="26" height="34" viewBox="0 0 13 17"><path fill="#111"
  stroke="#fff" d="M1 1v12l3-3 2.2 5 2.2-1-2.2-5H10z"/></svg>`;
window.film = (x, y, isHeld, text, times) => {
  cursor.style.transform = `translate(${x}px, ${y}px) scale(${isHeld ? 0.85 : 1})`;
  words.textContent = text;
  speed.textContent = times > 1 ? `${times} times as fast` : "";
};
"""
# A picture is drawn when it is wanted: in software it takes as long as a frame.
QUIET = """
const draw = viewer.renderer.render.bind(viewer.renderer);
let wanted = false;
viewer.renderer.render = (...all) => { if (wanted) draw(...all); };
window.drawn = () => new Promise((done) => {
  wanted = true;
  viewer.set_dirty();
  requestAnimationFrame(() => requestAnimationFrame(() => { wanted = false; done(); }));
});
window.looked = () => new Promise((done) =>
  requestAnimationFrame(() => requestAnimationFrame(done)));
"""
# The pixel over which a point of the world is.
PIXEL = """(() => {
  const p = viewer.scene.localToWorld(new THREE.Vector3(...%s)).project(viewer.camera);
  const r = viewer.renderer.domElement.getBoundingClientRect();
  return [r.left + (p.x + 1) / 2 * r.width, r.top + (1 - p.y) / 2 * r.height];
})()"""
# The point of the world that the mouse has grabbed.
GRABBED = """(() => {
  const p = viewer.scene.worldToLocal(mouseDrag.targetWorld.clone());
  return [p.x, p.y, p.z];
})()"""
MIDDLE = """(() => {
  const r = document.querySelector("[data-name=%s]").getBoundingClientRect();
  return [(r.left + r.right) / 2, (r.top + r.bottom) / 2];
})()"""


class Film:
    """A session of teaching with its page, and the pictures taken of it.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        For the browser's profile.
    """

    def __init__(self, scenario, folder):
        self.panel = open_page(title="teach")
        self.session = TeachingSession(
            scenario, MouseOnPage(self.panel.meshcat), panel=self.panel, clock=None
        )
        self.buttons = TeachPage(self.panel, scenario)
        self.session.advance(0.5)
        self.buttons.show(self.session)
        self.page = Page(self.panel.url, folder, size=SIZE, seldom=False)
        self.page.wait_for_meshcat()
        self.page.settled_picture()
        self.page.run(f"(() => {{ {OVERLAY} {QUIET} }})()")
        self.at, self.is_held = np.array(BEGIN, dtype=float), False
        self.pictures = []

    def close(self):
        """End browser and page."""
        self.page.close()
        self.panel.close()

    def _wait(self, promise):
        self.panel.meshcat.Flush()
        self.page.call("Runtime.evaluate", expression=promise, awaitPromise=True)

    def pixel(self, point):
        """Return the pixel over which a point of the world is."""
        return self.page.run(PIXEL % json.dumps([float(x) for x in point]))

    def move(self, to):
        """Move the mouse to a pixel."""
        self.at = np.array(to, dtype=float)
        self.page.mouse("moved", *self.at, pressed=self.is_held)

    def shoot(self, words, *, times=1, seconds=None):
        """Simulate for as long as a picture stands, and take one."""
        self.session.advance(times / FPS if seconds is None else seconds)
        self.buttons.show(self.session)
        said = json.dumps([*self.at, self.is_held, words, times])
        self.page.run(f"film(...{said})")
        self._wait("drawn()")
        data = self.page.call("Page.captureScreenshot", format="png")["data"]
        picture = Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")
        self.pictures.append(picture)

    def glide(self, to, words, *, seconds=0.7):
        """Move the mouse to a pixel, seen."""
        start, count = self.at, round(seconds * FPS)
        for i in range(1, count + 1):
            part = (1 - np.cos(np.pi * i / count)) / 2
            self.move(start + part * (np.array(to) - start))
            self.shoot(words)

    def drag(self, path, words, *, seconds, times):
        """Drag along points of the world, a function of time."""
        looks = round(LOOKS * times / FPS)
        for i in range(round(seconds * FPS / times)):
            for j in range(looks):
                point = path((i * looks + j) * times / FPS / looks)
                self.move(self.pixel(point))
                self._wait("looked()")
                self.session.advance(times / FPS / looks)
            self.shoot(words, times=times, seconds=0.0)

    def click(self, name, words):
        """Click a button of the panel with the mouse, seen."""
        self.glide(self.page.run(MIDDLE % name), words)
        for _ in range(4):
            self.shoot(words)
        self.page.mouse("pressed", *self.at)
        self.page.mouse("released", *self.at)
        while self.buttons.press_clicked_button(self.session) != name:
            self._wait("looked()")

    def save(self, path):
        """Write the pictures as a film that every browser shows."""
        first, *others = self.pictures
        first.save(
            path,
            save_all=True,
            append_images=others,
            duration=[*[round(1000 / FPS)] * len(others), 2000],
            loop=0,
            quality=QUALITY,
            method=6,
        )


def photograph_page(path):
    """Write a picture of the page of a run."""
    scenario = LoadScenario("table_top")
    skill, demonstrations, _ = scenario_skill(scenario)
    panel = open_page(title="table_top")
    run = WipingRun(
        scenario,
        skill,
        demonstrations=demonstrations,
        panel=panel,
        meshcat=panel.meshcat,
    )
    run.advance_to(4.0)
    with (
        RunButtons(panel.meshcat, panel) as buttons,
        tempfile.TemporaryDirectory() as folder,
        Page(panel.url, Path(folder), size=(1200, 800), seldom=False) as page,
    ):
        assert not buttons.paused
        page.wait_for_scene(panel.meshcat)
        picture = page.settled_picture()
    panel.close()
    Image.fromarray(np.uint8(255 * picture)).save(path, optimize=True)


def main():
    if sys.argv[1].endswith(".png"):
        photograph_page(sys.argv[1])
        return
    scenario = LoadScenario("table_top")
    scenario.camera.eye, scenario.camera.target = EYE, TARGET
    with tempfile.TemporaryDirectory() as folder:
        film = Film(scenario, Path(folder))
        words = "1  teach: drag the eraser"
        for _ in range(4):
            film.shoot(words)
        film.glide(film.page.centre("drake", "bodies", "eraser", "eraser"), words)
        film.is_held = True
        film.page.mouse("pressed", *film.at)
        grip = film.page.run(GRABBED)

        def path(time):
            phase = 2 * np.pi * time / PERIOD
            way = np.multiply(EXTENT, [np.sin(phase), np.sin(3 * phase)])
            way[0] += AHEAD
            return [*(grip[:2] + (1 - np.exp(-time / 0.5)) * way), grip[2]]

        film.drag(path, words, seconds=SHOWN, times=4)
        film.is_held = False
        film.page.mouse("released", *film.at)
        film.click("learn", "2  press learn")
        words = "3  it wipes on by itself"
        film.glide(ASIDE, words, seconds=0.5)
        for _ in range(round(PLAYED * FPS / 2)):
            film.shoot(words, times=2)
        sys.stdout.write(f"{film.session.status}\n")
        film.save(sys.argv[1])
        film.close()


if __name__ == "__main__":
    main()
