"""Facts about the ink in a recording of Meshcat."""

import json
import re

import numpy as np
import pytest
from browser import needs_chromium, open_page
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from fmp_drake.errors import SystemsError
from fmp_drake.systems.ink import mesh as ink_mesh_module
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import AddInkToRecording, ink_colours

GRID = InkGrid(size=(0.4, 0.3), cell=0.01)
X_WB = RigidTransform([0.5, 0.0, 0.1])


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


TIMES = np.arange(0.0, 4.01, 0.1)


def inks():
    """Rows are wiped one after the other; then four keep 40 and four 80 % of the ink."""
    ink = np.full((len(TIMES), *GRID.shape), 255, dtype=np.uint8)
    for row, time in enumerate(np.linspace(0.1, 3.9, 20)):
        ink[time - 1e-9 <= TIMES, row] = 0
    ink[TIMES >= 3.0, 20:24] = 102
    ink[TIMES >= 1.0, 24:28] = 204
    return ink


def record(meshcat, **options):
    meshcat.DeleteRecording()
    meshcat.StartRecording(frames_per_second=32.0)
    meshcat.StopRecording()
    arrays = {"times": TIMES, "ink": inks().reshape(len(TIMES), -1)}
    return AddInkToRecording(meshcat, grid=GRID, **(arrays | options))


def test_a_recording_has_two_layers_per_second_and_not_too_many(meshcat, monkeypatch):
    assert record(meshcat) == 8
    assert all(meshcat.HasPath(f"ink/recorded/layer_{i:03d}") for i in range(8))
    assert not meshcat.HasPath("ink/recorded/layer_008")
    monkeypatch.setattr(ink_mesh_module, "MAX_LAYERS", 3)
    assert record(meshcat) == 3


def test_layers_are_the_initial_ink_over_the_final_one(meshcat, monkeypatch):
    drawn = {}
    monkeypatch.setattr(
        ink_mesh_module,
        "draw_ink",
        lambda _, path, mesh: drawn.update({path: mesh}) or True,
    )
    record(meshcat)
    remains = drawn.pop("ink/recorded/remains")[0]
    size = remains[:2, 2::4] - remains[:2, 0::4]
    # The upper third, and one more row that fades into it.
    assert size.prod(axis=0).sum() == pytest.approx(0.4 * 0.11, rel=0.021)
    area = 0.0
    for vertices, _, colours in drawn.values():
        size = vertices[:2, 2::4] - vertices[:2, 0::4]
        area += size.prod(axis=0).sum()
        assert (vertices[2] > remains[2].max()).all()
        np.testing.assert_allclose(colours, ink_colours(np.ones(colours.shape[1])).T)
    # What changes, and two more rows.
    assert area == pytest.approx(0.4 * 0.30, rel=0.021)


def test_a_recording_replaces_the_live_ink_and_leaves_all_else(meshcat):
    meshcat.Delete()
    meshcat.SetTransform("board/ink", RigidTransform([0.5, 0.0, 0.1]))
    meshcat.SetTransform("board/ink/live", RigidTransform())
    before = meshcat._GetPackedTransform("board/ink")
    record(meshcat, path="board/ink")
    assert not meshcat.HasPath("board/ink/live")
    assert meshcat.HasPath("board/ink/recorded/remains")
    assert meshcat._GetPackedTransform("board/ink") == before != b""


def test_a_recording_refuses_arrays_of_another_grid(meshcat):
    with pytest.raises(SystemsError, match="the first ink has 7 values"):
        record(meshcat, ink=np.ones((len(TIMES), 7), dtype=np.uint8))


def test_no_cell_shows_its_end_before_its_time(meshcat, monkeypatch):
    """Seen from above: where and when the initial ink is hidden."""
    drawn = {}
    monkeypatch.setattr(
        ink_mesh_module,
        "draw_ink",
        lambda _, path, mesh: drawn.update({path: mesh}) or True,
    )
    hidden = {}
    monkeypatch.setattr(
        ink_mesh_module,
        "show_during",
        lambda _, path, **when: hidden.update({path: when["until"]}),
    )
    record(meshcat)
    for row, time in ((2, 0.5), (10, 2.1), (21, 3.0), (26, 1.0), (28, 1.0)):
        y = GRID.corner[1] + (row + 0.5) * GRID.pitch[1]
        over = [
            path
            for path, (v, _, _) in drawn.items()
            if np.any((v[1, 0::4] < y) & (y < v[1, 2::4])) and path in hidden
        ]
        assert [hidden[path] for path in over] == [pytest.approx(time, abs=0.26)]


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
def test_replay_wipes_the_ink_and_restores_it_at_its_start(meshcat, tmp_path):
    meshcat.Delete()
    record(meshcat)
    meshcat.SetTransform("ink", X_WB)
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
    assert 0.02 * full < four < 0.4 * full
