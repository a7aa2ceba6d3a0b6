"""Facts about the monitor of what is below a surface."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import SystemsError
from fmp_drake.systems import ImpedanceStatus, StatusFlag
from fmp_drake.systems.surface.surface import PLANE, Surface
from fmp_drake.systems.surface_monitor import SurfaceMonitor, along, clearances

X_BOARD = RigidTransform(RotationMatrix.MakeYRotation(-np.pi / 2), [0.4, 0.0, 0.9])
X_BOARD_B = RigidTransform([0.0, 0.0, 0.01])
BOX = np.array([[-0.25, -0.35, -0.02], [0.25, 0.35, 0.0]])


def make_monitor(**changes):
    plant = MultibodyPlant(0.001)
    board, tool = (plant.AddRigidBody(name) for name in ("board", "tool"))
    surface = plant.AddFrame(FixedOffsetFrame("surface", board, X_BOARD_B))
    plant.Finalize()
    options = {
        "surface": surface,
        "box": BOX,
        "bodies": [tool.index(), tool.index()],
        "points": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]],
        "radii": [0.02, 0.0],
        "on_arm": [False, False],
    }
    return SurfaceMonitor(**{**options, **changes})


def look(monitor, p_B):
    """Return depth and flags with the tool's frame at a place in B, upright in W."""
    context = monitor.CreateDefaultContext()
    X_WB = X_BOARD @ X_BOARD_B
    tool = RigidTransform(X_WB @ np.array(p_B, dtype=float))
    poses = [RigidTransform(), X_BOARD, tool]
    monitor.get_input_port().FixValue(context, poses)
    before = context.get_discrete_state(0).value().copy()
    assert not before.any()
    simulator = Simulator(monitor, context)
    simulator.AdvanceTo(0.03)
    context = simulator.get_context()
    status = monitor.GetOutputPort("status").Eval(context)
    depth = monitor.GetOutputPort("penetration").Eval(context)[0]
    return depth, ImpedanceStatus.from_vector(status).flags


def test_ports_are_state_of_these_names():
    monitor = make_monitor()
    ports = [monitor.get_output_port(i) for i in range(monitor.num_output_ports())]
    assert {p.get_name(): p.size() for p in ports} == {"penetration": 1, "status": 6}
    assert monitor.get_input_port().get_name() == "body_poses"
    assert not monitor.HasAnyDirectFeedthrough()


def test_points_over_the_surface_are_not_below_it():
    assert look(make_monitor(), [0.0, 0.0, 0.021]) == (0.0, 0)


def test_deepest_sphere_determines_the_penetration():
    depth, flags = look(make_monitor(), [0.1, 0.1, 0.018])
    assert depth == pytest.approx(0.002)
    assert flags == 0
    depth, flags = look(make_monitor(), [0.1, 0.1, -0.03])
    assert depth == pytest.approx(0.05)
    assert flags == StatusFlag.BELOW_SURFACE
    # z of the tool is x of the board here: its other end is at the same height.
    depth, _ = look(make_monitor(radii=[0.0, 0.01]), [0.1, 0.1, -0.03])
    assert depth == pytest.approx(0.04)


@pytest.mark.parametrize("beside", [[0.26, 0.0, -0.1], [0.0, -0.36, -0.1]])
def test_points_beside_the_board_are_not_below_its_surface(beside):
    assert look(make_monitor(), beside) == (0.0, 0)


@pytest.mark.parametrize(
    ("place", "touches"),
    [
        ([0.1, 0.1, 0.019], True),
        ([0.1, 0.1, 0.021], False),
        ([0.269, 0.0, -0.01], True),
        ([0.271, 0.0, -0.01], False),
        ([0.0, 0.0, -0.039], True),
        # Behind the board, or across its edge from a ball whose sides would touch.
        ([0.0, 0.0, -0.041], False),
        ([0.265, 0.365, -0.01], False),
    ],
)
def test_an_arm_touches_the_board_from_all_sides(place, touches):
    monitor = make_monitor(on_arm=[True, False])
    assert bool(look(monitor, place)[1] & StatusFlag.ARM_TOUCHES) == touches
    assert not look(make_monitor(), place)[1] & StatusFlag.ARM_TOUCHES


def test_distance_in_a_board_is_that_to_its_nearest_side():
    p = np.array([[0.0, 0.0, -0.005], [0.24, 0.0, -0.011], [0.28, 0.39, -0.01]])
    found = clearances(p, np.array([0.0, 0.01, 0.01]), BOX)
    np.testing.assert_allclose(found, [-0.005, -0.019, 0.04], atol=1e-12)


@pytest.mark.parametrize(("below", "is_below"), [(0.009, False), (0.011, True)])
def test_half_the_thickness_of_the_board_is_tolerated(below, is_below):
    depth, flags = look(make_monitor(), [0.1, 0.1, 0.02 - below])
    assert depth == pytest.approx(below)
    assert flags == StatusFlag.BELOW_SURFACE * is_below


def test_what_goes_below_the_surface_is_reported_within_20_ms():
    monitor = make_monitor()
    context = monitor.CreateDefaultContext()
    port = monitor.get_input_port()
    above, below = (
        RigidTransform((X_BOARD @ X_BOARD_B).rotation(), X_BOARD @ X_BOARD_B @ p)
        for p in (np.array([0.1, 0.1, 0.5]), np.array([0.1, 0.1, -0.03]))
    )
    port.FixValue(context, [RigidTransform(), X_BOARD, above])
    simulator = Simulator(monitor, context)
    simulator.AdvanceTo(0.001)
    context = simulator.get_mutable_context()
    depth = monitor.GetOutputPort("penetration")
    assert depth.Eval(context)[0] == 0.0
    port.FixValue(context, [RigidTransform(), X_BOARD, below])
    simulator.AdvanceTo(0.021)
    assert depth.Eval(context)[0] == pytest.approx(0.05)


def test_an_arm_in_the_board_is_below_it_and_touches_it():
    _, flags = look(make_monitor(on_arm=[True, False]), [0.1, 0.1, -0.03])
    assert flags == StatusFlag.BELOW_SURFACE | StatusFlag.ARM_TOUCHES


def test_a_link_behind_the_board_is_not_below_its_surface():
    # As the shoulder of an arm whose base is beside a bowl.
    behind = [0.1, 0.1, -0.041]
    assert look(make_monitor(on_arm=[True, True]), behind) == (0.0, 0)
    assert look(make_monitor(), behind)[1] == StatusFlag.BELOW_SURFACE


def test_distances_from_a_pipe_are_along_its_radius():
    """A quarter of a pipe of 0.2 m along x, whose axis is 0.2 m below B."""
    pipe = Surface(kx=0.0, ky=5.0)
    angles = np.array([0.0, 0.5, -0.5, 1.2])
    p = np.stack([[0.1, 0.25 * np.sin(a), 0.25 * np.cos(a) - 0.2] for a in angles])
    uvh = along(pipe, p.reshape(2, 2, 3))
    expected = np.stack([[0.1, 0.2 * a, 0.05] for a in angles]).reshape(2, 2, 3)
    np.testing.assert_allclose(uvh, expected, atol=1e-9)
    box = np.array([[-0.25, -0.2 * np.pi / 4, -0.02], [0.25, 0.2 * np.pi / 4, 0.0]])
    beside = np.hypot(0.05, 0.2 * (1.2 - np.pi / 4))
    found = clearances(uvh, np.array([0.0, 0.01]), box)
    np.testing.assert_allclose(found, [[0.05, 0.04], [0.05, beside - 0.01]])
    np.testing.assert_array_equal(along(PLANE, p), p)


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(SystemsError, match="points"):
        make_monitor(points=[[0.0, 0.0, 0.0]])
