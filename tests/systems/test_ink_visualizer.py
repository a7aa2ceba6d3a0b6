"""Facts about showing ink in Meshcat while it is simulated."""

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    LeafSystem,
)

from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import LEVELS, ink_mesh
from fmp_drake.systems.page import ink_visualizer
from fmp_drake.systems.page.ink_visualizer import TILE, InkVisualizer

GRID = InkGrid(size=(0.4, 0.3), cell=0.005)
PATHS = ("board/ink", "board/ink/words")


class FadingInk(LeafSystem):
    """Ink of which a row goes at 0.5 s, and the next one at 1.5 s."""

    def __init__(self, row):
        super().__init__()
        self._row = row
        self.DeclareVectorOutputPort("ink", GRID.num_cells, self._calc)

    def _calc(self, context: Context, output: BasicVector):
        ink = GRID.full()
        ink[self._row] = context.get_time() < 0.49
        if self._row == 0:
            ink[1] = context.get_time() < 1.49
        output.SetFromVector(ink.ravel())


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def drawn(monkeypatch):
    """Collect the origins and the corner shades of the tiles that are drawn."""
    calls = []

    def spy(grid, corners, *, origin, **options):
        calls.append((origin, corners.copy()))
        return ink_mesh(grid, corners, origin=origin, **options)

    monkeypatch.setattr(ink_visualizer, "ink_mesh", spy)
    return calls


def make_diagram(meshcat, *, row=0, **options):
    builder = DiagramBuilder()
    source = builder.AddSystem(FadingInk(row))
    visualizer = builder.AddSystem(InkVisualizer(meshcat=meshcat, grid=GRID, **options))
    builder.Connect(source.GetOutputPort("ink"), visualizer.GetInputPort("ink"))
    return builder.Build(), visualizer


def test_ports_have_names_and_sizes(meshcat):
    visualizer = InkVisualizer(meshcat=meshcat, grid=GRID)
    assert visualizer.get_name() == "ink_visualizer"
    assert visualizer.num_input_ports() == 1
    assert visualizer.num_output_ports() == 0
    assert visualizer.GetInputPort("ink").size() == GRID.num_cells


ALL = [(row, column) for row in (0, TILE) for column in (0, TILE, 2 * TILE)]
LOWEST = ALL[:3]


def test_only_tiles_whose_shades_change_are_drawn(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.01)
    assert {origin for origin, _ in drawn} == set(ALL)
    assert meshcat.HasPath(f"ink/live/tile_{TILE}_0")
    drawn.clear()
    simulator.AdvanceTo(0.45)
    assert not drawn
    simulator.AdvanceTo(1.0)
    assert [origin for origin, _ in drawn] == LOWEST
    simulator.AdvanceTo(3.0)
    assert [origin for origin, _ in drawn] == 2 * LOWEST
    for (_, corners), clean in zip(drawn[::3], (1, 2), strict=True):
        # The corners of the clean row; those it shares are in between.
        assert (corners[:clean] == 0).all()
        assert (corners[clean] == LEVELS // 2).all()
        assert (corners[clean + 1 :] == LEVELS).all()


def test_a_corner_between_tiles_changes_both(meshcat, drawn):
    diagram, _ = make_diagram(meshcat, row=TILE)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.01)
    drawn.clear()
    simulator.AdvanceTo(1.0)
    assert [origin for origin, _ in drawn] == ALL


def test_a_tile_without_ink_disappears(meshcat):
    diagram, _ = make_diagram(meshcat, row=slice(None))
    simulator = Simulator(diagram)
    simulator.Initialize()
    assert meshcat.HasPath("ink/live/tile_0_0")
    simulator.AdvanceTo(1.0)
    assert not meshcat.HasPath("ink/live/tile_0_0")


def test_pictures_come_once_in_a_period(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.01)
    drawn.clear()
    # The row has gone at 0.49 s; pictures come at multiples of 0.128 s.
    simulator.AdvanceTo(0.50)
    assert not drawn
    simulator.AdvanceTo(0.52)
    assert [origin for origin, _ in drawn] == LOWEST


@pytest.mark.parametrize("moment", [0.3, 0.7])
def test_a_continued_run_shows_the_ink_at_once_and_has_the_same_state(
    meshcat, drawn, moment
):
    diagram, visualizer = make_diagram(meshcat)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(moment)
    copy = Simulator(diagram, simulator.get_context().Clone())
    drawn.clear()
    copy.Initialize()
    assert [origin for origin, _ in drawn] == ALL
    shades = []
    for each in (simulator, copy):
        each.AdvanceTo(1.0)
        own = visualizer.GetMyContextFromRoot(each.get_context())
        shades.append(own.get_discrete_state(0).value().copy())
    np.testing.assert_array_equal(*shades)


def test_two_interleaved_simulations_draw_the_same(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    simulators = [Simulator(diagram), Simulator(diagram)]
    seen = [[], []]
    for t in (0.0, 0.3, 0.6, 1.2, 2.0):
        for simulator, calls in zip(simulators, seen, strict=True):
            drawn.clear()
            simulator.AdvanceTo(t)
            calls += drawn
    assert len(seen[0]) == len(seen[1]) > len(ALL)
    for one, two in zip(*seen, strict=True):
        assert one[0] == two[0]
        np.testing.assert_array_equal(one[1], two[1])


def test_drawing_does_not_depend_on_caching(meshcat, drawn):
    diagram, _ = make_diagram(meshcat)
    runs = []
    for caching in (True, False):
        drawn.clear()
        simulator = Simulator(diagram)
        if not caching:
            simulator.get_mutable_context().DisableCaching()
        simulator.AdvanceTo(2.0)
        runs.append(list(drawn))
    for (origin, corners), (same, same_corners) in zip(*runs, strict=True):
        assert origin == same
        np.testing.assert_array_equal(corners, same_corners)


def test_publishing_on_demand_draws_and_leaves_the_context_alone(meshcat, drawn):
    diagram, visualizer = make_diagram(meshcat)
    context = diagram.CreateDefaultContext()
    own = visualizer.GetMyContextFromRoot(context)
    before = own.get_discrete_state(0).value().copy()
    diagram.ForcedPublish(context)
    assert len(drawn) == len(ALL)
    np.testing.assert_array_equal(own.get_discrete_state(0).value(), before)


def test_starting_again_draws_again_and_touches_only_its_own_paths(meshcat):
    meshcat.Delete()
    X_WB = RigidTransform([0.5, 0.0, 0.1])
    meshcat.SetTransform("board/ink", X_WB)
    meshcat.SetTransform("board/ink/words", RigidTransform([0.1, 0.0, 0.0]))
    diagram, _ = make_diagram(meshcat, path="board/ink")
    Simulator(diagram).Initialize()
    packed = {path: meshcat._GetPackedTransform(path) for path in PATHS}
    meshcat.SetTransform("board/ink/recorded/layer_000", RigidTransform())
    meshcat.SetTransform("board/ink/live/tile_9_9", RigidTransform())
    Simulator(diagram).Initialize()
    assert meshcat.HasPath("board/ink/live/tile_0_0")
    assert not meshcat.HasPath("board/ink/live/tile_9_9")
    assert not meshcat.HasPath("board/ink/recorded")
    for path in PATHS:
        assert meshcat._GetPackedTransform(path) == packed[path] != b""


def test_a_forgotten_input_is_named(meshcat):
    visualizer = InkVisualizer(meshcat=meshcat, grid=GRID)
    with pytest.raises((RuntimeError, ValueError), match=r"ink.*ink_visualizer"):
        visualizer.ForcedPublish(visualizer.CreateDefaultContext())
