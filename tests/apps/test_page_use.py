"""Facts about using the page: the mouse, the sliders and the buttons in a browser."""

import itertools
import threading
import time

import numpy as np
import pytest
from browser import CTRL, Page, needs_chromium
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from fmp_drake.runs.simulation_loop import RunButtons, advance
from fmp_drake.station.arm_controller import AddArmController
from fmp_drake.station.board_scene import AddBoardScene
from fmp_drake.station.external_forces import AddMousePull
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.systems.page.page_controls import PageControls

pytestmark = [pytest.mark.browser, needs_chromium]

OPEN_CONTROLS = """(() => {
  const b = [...document.querySelectorAll('.close-button')].pop();
  if (b.textContent.includes('Open')) { b.click(); }
  return true;
})()"""
# The middle of a control's row, and for a slider the ends of its track.
ROW = """(() => {
  const c = viewer.gui_controllers[%r];
  if (!c) return null;
  const s = c.__foreground ? c.__background : c.__li;
  const r = s.getBoundingClientRect();
  return r.width ? [r.left, r.right, (r.top + r.bottom) / 2] : null;
})()"""


class Holding:
    """An arm that holds its eraser over the board, with all controls."""

    def __init__(self):
        self.meshcat = Meshcat()
        self.meshcat.SetCameraPose([1.35, -0.75, 0.85], [0.42, 0.0, 0.2])
        builder = DiagramBuilder()
        scenario = LoadScenario("table_top")
        start = np.array([0.0, 0.0, 0.1])
        self.scene = AddBoardScene(builder, scenario, start=start)
        controller = AddArmController(builder, self.scene, scenario.impedance)
        for name, value in {
            "desired_position": start,
            "desired_velocity": np.zeros(3),
            "desired_acceleration": np.zeros(3),
            "feedforward_wrench": np.zeros(6),
        }.items():
            source = builder.AddSystem(ConstantVectorSource(value))
            builder.Connect(source.get_output_port(), controller.GetInputPort(name))
        MeshcatVisualizer.AddToBuilder(
            builder,
            self.scene.scene_graph,
            self.meshcat,
            MeshcatVisualizerParams(
                prefix="bodies", delete_on_initialization_event=False
            ),
        )
        self.plant = self.scene.plant
        pull = AddMousePull(builder, self.plant, self.scene.scene_graph, self.meshcat)
        builder.Connect(pull, self.plant.GetInputPort("applied_spatial_force"))
        self.pull = pull
        self.controls = builder.AddSystem(PageControls(self.meshcat))
        self.tempo = LogVectorOutput(
            self.controls.GetOutputPort("tempo"), builder, 0.05
        )
        self.simulator = Simulator(builder.Build())

    def eraser(self):
        """Return p_WE, m."""
        context = self.plant.GetMyContextFromRoot(self.simulator.get_context())
        return self.scene.robot.tip.CalcPoseInWorld(context).translation()

    def force(self):
        """Return the force of the mouse on the plant, N, and its body's name."""
        system = self.pull.get_system()
        context = system.GetMyContextFromRoot(self.simulator.get_context())
        forces = self.pull.Eval(context)
        if not forces:
            return np.zeros(3), None
        (force,) = forces
        body = self.plant.get_body(force.body_index).name()
        return force.F_Bq_W.translational(), body

    def output(self, name):
        context = self.controls.GetMyContextFromRoot(self.simulator.get_context())
        return self.controls.GetOutputPort(name).Eval(context)[0]


@pytest.fixture(scope="module")
def holding():
    return Holding()


@pytest.fixture(scope="module")
def page(holding, tmp_path_factory):
    holding.simulator.Initialize()
    with Page(holding.meshcat.web_url(), tmp_path_factory.mktemp("page")) as page:
        page.wait_for_meshcat()
        page.grab("drake", "bodies", "eraser", "eraser")
        yield page


@pytest.fixture
def begun(holding):
    """Restart."""
    context = holding.simulator.get_mutable_context()
    holding.simulator.get_system().SetDefaultContext(context)
    context.SetTime(0.0)
    holding.simulator.Initialize()
    holding.simulator.AdvanceTo(0.05)
    return holding


def step_until(holding, condition, *, seconds=60.0):
    """Step the simulation in small pieces of its time until a condition holds."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        holding.simulator.AdvanceTo(holding.simulator.get_context().get_time() + 0.02)
        # The page also needs a processor.
        time.sleep(0.01)


def row(page, name):
    page.run(OPEN_CONTROLS)
    return page.wait_for(ROW % name)


def set_slider(page, name, share):
    """Click at a fraction of the track of a slider."""
    left, right, y = row(page, name)
    page.click(left + share * (right - left), y)


def press(page, name):
    left, right, y = row(page, name)
    page.click((left + right) / 2, y)


def test_drag_with_ctrl_moves_the_eraser_and_releases_it(begun, page):
    at = page.grab("drake", "bodies", "eraser", "eraser")
    rest = begun.eraser()
    to = [at[0] + 80, at[1]]
    page.drag(at, to, modifiers=CTRL)
    wiggle = itertools.cycle([0, 1])

    def pulled():
        # A picture takes a second in software, and a drag on a silent page ends.
        page.mouse("moved", to[0] + next(wiggle), to[1], modifiers=CTRL)
        return np.linalg.norm(begun.eraser() - rest) > 0.02

    step_until(begun, pulled)
    force, body = begun.force()
    assert body == "eraser"
    assert 5 < np.linalg.norm(force) < 40.01
    # Towards the mouse: to the right, seen from the camera.
    right = np.cross([0.42 - 1.35, 0.75, 0.0], [0.0, 0.0, 1.0])
    assert (begun.eraser() - rest) @ right > 0
    page.mouse("released", *to, modifiers=CTRL)
    step_until(begun, lambda: not begun.force()[0].any())
    step_until(begun, lambda: np.linalg.norm(begun.eraser() - rest) < 0.005)


def test_a_drag_without_ctrl_turns_the_view_and_moves_nothing(begun, page):
    at = page.centre("drake", "bodies", "eraser", "eraser")
    rest = begun.eraser()
    before = page.run("JSON.stringify(viewer.camera.matrixWorld.elements)")
    page.mouse("moved", *at, pressed=False)
    page.mouse("pressed", *at)
    page.drag(at, [at[0] + 80, at[1]])
    page.wait_for(f"JSON.stringify(viewer.camera.matrixWorld.elements) !== {before!r}")
    begun.simulator.AdvanceTo(0.3)
    page.mouse("released", at[0] + 80, at[1])
    assert begun.force()[1] is None
    assert np.linalg.norm(begun.eraser() - rest) < 1e-3


def test_sliders_of_the_page_are_outputs_of_the_diagram(begun, page):
    assert begun.output("tempo") == 1.0
    set_slider(page, "tempo", 0.98)
    step_until(begun, lambda: begun.output("tempo") > 1.8)
    set_slider(page, "press force (N)", 0.2)
    step_until(begun, lambda: 2 < begun.output("press_force") < 4)
    assert begun.output("sample") == 0
    set_slider(page, "sample", 0.9)
    step_until(begun, lambda: begun.output("sample") == 1)


def test_an_initialisation_sets_the_sliders_back_in_the_page(begun, page):
    value = "viewer.gui_controllers['tempo'].getValue()"
    set_slider(page, "tempo", 0.98)
    page.wait_for(f"{value} > 1.8")
    begun.simulator.Initialize()
    page.wait_for(f"{value} === 1")
    assert begun.output("tempo") == 1.0


@pytest.mark.usefixtures("nothing_is_freed")
def test_buttons_pause_a_run_and_reset_it(begun, page):
    simulator, resets, seen = begun.simulator, [], {}
    now = simulator.get_context().get_time

    def wait_until(condition):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, f"at {now()} s"
            time.sleep(0.02)

    def stands_still():
        before = now()
        time.sleep(0.5)
        return now() == before

    # Meshcat's own functions are for the main thread only; the page is for any.
    def click():
        try:
            page.wait_for(ROW % RunButtons.PAUSE)
            wait_until(lambda: now() > 0.1)
            assert not stands_still()
            press(page, RunButtons.PAUSE)
            wait_until(stands_still)
            seen["paused"] = now()
            press(page, RunButtons.RESET)
            wait_until(lambda: now() == 0.0)
            assert stands_still()
            seen["reset"] = now()
        finally:
            # Continue as fast as possible.
            simulator.set_target_realtime_rate(0.0)
            press(page, RunButtons.PAUSE)

    page.run(OPEN_CONTROLS)
    simulator.set_target_realtime_rate(0.2)
    clicking = threading.Thread(target=click)
    clicking.start()
    for _ in advance(
        simulator,
        3.0,
        meshcat=begun.meshcat,
        on_reset=lambda: resets.append(now()),
    ):
        pass
    clicking.join()
    assert 0.1 < seen["paused"] < 3.0
    assert seen["reset"] == 0.0
    assert resets == [0.0]
    assert now() == 3.0
    # The logs have restarted, and the buttons are removed.
    log = begun.tempo.FindLog(simulator.get_context())
    assert log.sample_times()[0] == 0.0
    assert np.all(np.diff(log.sample_times()) > 0)
    assert begun.meshcat.GetButtonNames() == []
