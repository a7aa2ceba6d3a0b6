"""Facts about where an eraser has wiped, as far as an arm knows."""

import numpy as np
from pydrake.systems.analysis import Simulator

from fmp_drake.systems import InkGrid
from fmp_drake.systems.wiped_area import WipedArea

GRID = InkGrid(size=(0.4, 0.3), cell=0.01)
FOOTPRINT = (0.06, 0.04)


def wipe(path, force):
    """Return the ink after a path, 50 ms from point to point, with these forces."""
    system = WipedArea(GRID, footprint=FOOTPRINT)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    for k, (point, pressed) in enumerate(zip(path, force, strict=True)):
        system.GetInputPort("measured_position").FixValue(context, [*point, 0.0])
        system.GetInputPort("normal_force").FixValue(context, [pressed])
        simulator.AdvanceTo(0.05 * (k + 1) - 1e-3)
    return system.GetOutputPort("ink").Eval(context).reshape(GRID.shape)


def test_ports():
    system = WipedArea(GRID, footprint=FOOTPRINT)
    assert system.GetInputPort("measured_position").size() == 3
    assert system.GetInputPort("normal_force").size() == 1
    assert system.GetOutputPort("ink").size() == GRID.num_cells
    assert not system.HasAnyDirectFeedthrough()


def test_cells_passed_in_contact_are_clean():
    path = [(-0.1, 0.0), (0.0, 0.05), (0.1, 0.0), (0.1, -0.1)]
    ink = wipe(path, [10.0, 10.0, 10.0, 0.0])
    swept = GRID.swept_area([[*p, 0.0] for p in path[:3]], FOOTPRINT)
    np.testing.assert_array_equal(ink, ~swept)


def test_without_pressure_nothing_is_clean():
    assert np.all(wipe([(0.0, 0.0), (0.1, 0.0), (0.0, 0.0)], [0.0, 10.0, 0.0]) == 1)
    assert np.all(wipe([(0.0, 0.0), (0.1, 0.0)], [np.nan, np.nan]) == 1)
