"""Facts about showing ink in Meshcat, live and in a recording."""

import json
import re

import numpy as np
import pytest
from browser import needs_chromium, open_page
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    LeafSystem,
)

from fmp_drake.errors import StationError
from fmp_drake.systems import ink_visualizer
from fmp_drake.systems.ink_grid import InkGrid
from fmp_drake.systems.ink_visualizer import (
    BOARD_COLOUR,
    INK_COLOUR,
    LEVELS,
    LIFT,
    AddInkToRecording,
    InkVisualizer,
    ink_mesh,
    shades,
)

GRID = InkGrid(size=(0.4, 0.3), cell=0.01)
X_WB = RigidTransform([0.5, 0.0, 0.1])


class FadingInk(LeafSystem):
    """Ink whose first row goes at 0.5 s and whose second row goes at 1.5 s."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("ink", GRID.num_cells, self._calc)

    def _calc(self, context: Context, output: BasicVector):
        ink = GRID.full()
        ink[0] = context.get_time() < 0.49
        ink[1] = context.get_time() < 1.49
        output.SetFromVector(ink.ravel())


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def drawn(monkeypatch):
    """Collect the arguments of every drawing."""
    calls = []
    draw = ink_visualizer._draw

    def spy(meshcat, path, grid, shade):
        calls.append((path, shade.copy()))
        draw(meshcat, path, grid, shade)

    monkeypatch.setattr(ink_visualizer, "_draw", spy)
    return calls


def make_diagram(meshcat, **options):
    builder = DiagramBuilder()
    source = builder.AddSystem(FadingInk())
    visualizer = InkVisualizer.AddToBuilder(
        builder,
        source.GetOutputPort("ink"),
        meshcat=meshcat,
        grid=GRID,
        X_WB=X_WB,
        **options,
    )
    return builder.Build(), visualizer


def test_ports_have_names_and_sizes(meshcat):
    visualizer = InkVisualizer(meshcat=meshcat, grid=GRID, X_WB=X_WB)
    assert visualizer.get_name() == "ink_visualizer"
    assert visualizer.num_input_ports() == 1
    assert visualizer.num_output_ports() == 0
    assert visualizer.GetInputPort("ink").size() == GRID.num_cells


def test_ink_is_drawn_only_when_its_shades_change(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.Initialize()
    assert [path for path, _ in drawn] == ["ink/live"]
    assert meshcat.HasPath("ink/live")
    simulator.AdvanceTo(0.45)
    assert len(drawn) == 1
    simulator.AdvanceTo(1.0)
    assert len(drawn) == 2
    simulator.AdvanceTo(3.0)
    assert len(drawn) == 3
    for (_, shade), rows in zip(drawn, (0, 1, 2), strict=True):
        assert (shade[:rows] == 0).all()
        assert (shade[rows:] == LEVELS).all()


def test_drawing_is_no_faster_than_the_rate(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, rate=1.0)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.9)
    assert len(drawn) == 1
    simulator.AdvanceTo(1.01)
    assert len(drawn) == 2


def test_two_interleaved_simulations_draw_the_same(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulators = [Simulator(diagram), Simulator(diagram)]
    for t in (0.0, 0.3, 0.6, 1.2, 2.0):
        for simulator in simulators:
            simulator.AdvanceTo(t)
    assert len(drawn) == 6
    for one, two in zip(drawn[::2], drawn[1::2], strict=True):
        np.testing.assert_array_equal(one[1], two[1])


def test_drawing_does_not_depend_on_caching(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.get_mutable_context().DisableCaching()
    simulator.AdvanceTo(2.0)
    assert len(drawn) == 3


def test_publishing_on_demand_draws_and_leaves_the_context_alone(meshcat, drawn):
    diagram, visualizer = make_diagram(meshcat)
    context = diagram.CreateDefaultContext()
    own = visualizer.GetMyContextFromRoot(context)
    before = own.get_discrete_state(0).value().copy()
    diagram.ForcedPublish(context)
    assert len(drawn) == 1
    np.testing.assert_array_equal(own.get_discrete_state(0).value(), before)


def test_starting_again_draws_again_and_removes_the_recording(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    Simulator(diagram).Initialize()
    meshcat.SetTransform("ink/layer_000", RigidTransform())
    Simulator(diagram).Initialize()
    assert len(drawn) == 2
    assert meshcat.HasPath("ink/live")
    assert not meshcat.HasPath("ink/layer_000")


def test_a_forgotten_input_is_named(meshcat):
    visualizer = InkVisualizer(meshcat=meshcat, grid=GRID, X_WB=X_WB)
    with pytest.raises((RuntimeError, ValueError), match=r"ink.*ink_visualizer"):
        visualizer.ForcedPublish(visualizer.CreateDefaultContext())


@pytest.mark.parametrize("rate", [0.0, np.nan])
def test_a_bad_rate_is_refused(meshcat, rate):
    with pytest.raises(StationError, match="rate is"):
        InkVisualizer(meshcat=meshcat, grid=GRID, X_WB=X_WB, rate=rate)


def test_a_clean_board_has_no_mesh(meshcat):
    vertices, faces, colours = ink_mesh(GRID, np.zeros(GRID.shape, dtype=int))
    assert vertices.shape == colours.shape == (3, 0)
    assert faces.shape == (3, 0)
    ink_visualizer._draw(meshcat, "clean", GRID, shades(GRID.full()))
    assert meshcat.HasPath("clean")
    ink_visualizer._draw(meshcat, "clean", GRID, shades(0.01 * GRID.full()))
    assert not meshcat.HasPath("clean")


def test_the_mesh_covers_the_inked_cells_in_their_colours():
    rng = np.random.default_rng(5)
    shade = rng.integers(0, 3, GRID.shape) * (LEVELS // 2)
    vertices, faces, colours = ink_mesh(GRID, shade)
    assert (vertices[2] == LIFT).all()
    a, b, c = (vertices[:, i] for i in faces)
    normal = np.cross(b - a, c - a, axis=0)
    assert (normal[2] > 0.0).all()
    area = 0.5 * normal[2].sum()
    assert area == pytest.approx(np.count_nonzero(shade) * GRID.pitch.prod())
    painted = np.zeros(GRID.num_cells, dtype=int)
    x, y = GRID.centres.T
    for low, high, colour in zip(
        vertices[:2, 0::4].T, vertices[:2, 2::4].T, colours[:, 0::4].T, strict=True
    ):
        hit = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
        assert (painted[hit] == 0).all()
        full = np.allclose(colour, INK_COLOUR)
        half = np.allclose(colour, 0.5 * np.add(INK_COLOUR, BOARD_COLOUR))
        assert full or half
        painted[hit] = LEVELS if full else LEVELS // 2
    np.testing.assert_array_equal(painted.reshape(GRID.shape), shade)


def test_neighbours_of_one_shade_share_a_rectangle():
    vertices, _, _ = ink_mesh(GRID, shades(GRID.full()))
    assert vertices.shape == (3, 4 * GRID.shape[0])


def erase_times():
    """Rows go one after the other from 0.1 s on; the upper third stays."""
    rows = np.full(GRID.shape, np.inf)
    rows[:20] = np.linspace(0.1, 3.9, 20)[:, np.newaxis]
    return rows.ravel()


def record(meshcat, **options):
    meshcat.Delete()
    meshcat.DeleteRecording()
    meshcat.StartRecording(frames_per_second=32.0)
    meshcat.StopRecording()
    return AddInkToRecording(
        meshcat,
        grid=GRID,
        X_WB=X_WB,
        initial_ink=GRID.full(),
        erase_time=erase_times(),
        end_time=4.0,
        **options,
    )


def test_a_recording_has_two_layers_per_second_and_not_too_many(meshcat, drawn):
    assert record(meshcat) == 8
    paths = [path for path, _ in drawn]
    assert paths == ["ink/remains"] + [f"ink/layer_{i:03d}" for i in range(8)]
    layers = np.array([shade for _, shade in drawn])
    np.testing.assert_array_equal(layers.sum(axis=0), shades(GRID.full()))
    assert record(meshcat, layers_per_second=1000.0, max_layers=3) == 3


def test_a_recording_replaces_the_live_ink(meshcat):
    diagram, _ = make_diagram(meshcat)
    Simulator(diagram).Initialize()
    record(meshcat)
    assert not meshcat.HasPath("ink/live")
    assert meshcat.HasPath("ink/remains")


def test_a_recording_refuses_arrays_of_another_grid(meshcat):
    for name, options in (
        ("initial_ink", {"initial_ink": np.ones(7), "erase_time": erase_times()}),
        ("erase_time", {"initial_ink": GRID.full(), "erase_time": np.ones(7)}),
    ):
        with pytest.raises(StationError, match=f"7 values of {name}"):
            AddInkToRecording(meshcat, grid=GRID, X_WB=X_WB, end_time=4.0, **options)


PROBE = """
<script>
function bluePixels(time) {
  viewer.animator.seek(time);
  viewer.render();
  const gl = viewer.renderer.getContext();
  const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const p = new Uint8Array(4 * w * h);
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p);
  let n = 0;
  for (let i = 0; i < p.length; i += 4) if (p[i + 2] > p[i] + 60) n++;
  return n;
}
setTimeout(() => {
  viewer.animator.pause();
  const seen = [0, 1, 2, 4, 0].map(bluePixels);
  document.body.setAttribute("data-seen", JSON.stringify(seen));
}, 500);
</script>
"""


@pytest.mark.browser
@needs_chromium
def test_the_replay_wipes_the_ink_and_brings_it_back(meshcat, tmp_path):
    record(meshcat)
    meshcat.SetCameraPose([0.5, -0.3, 0.6], [0.5, 0.0, 0.1])
    meshcat.PublishRecording()
    html = meshcat.StaticHtml()
    assert html.count("</body>") == 1
    page = tmp_path / "replay.html"
    page.write_text(html.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    dump = open_page(page.as_uri(), tmp_path, "--dump-dom", milliseconds=3000)
    found = re.search(r'data-seen="([^"]*)"', dump)
    assert found, "the page has not run its script"
    full, one, two, four, again = json.loads(found.group(1))
    assert full > one > two > four > 0
    assert again == full
    # A third of the board stays inked; perspective makes the far third smaller.
    assert 0.1 * full < four < 0.4 * full
