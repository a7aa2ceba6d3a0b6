"""Facts about the coordinates of a tool that is guided over a curved board."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.math import RotationMatrix

from fmp_drake.systems.surface.surface import Surface, place, project, rotation
from fmp_drake.systems.surface_coordinates import SurfaceCoordinates

R_TE = RotationMatrix(np.diag([1.0, -1.0, -1.0]))
DOME = Surface(kx=3.0, ky=3.0)
UVH = np.array([0.1, -0.05, 0.02])
VELOCITY = np.array([0.2, -0.3, 0.1])


def position():
    return place(DOME, UVH[None])[0]


def outputs(quaternion=(1.0, 0.0, 0.0, 0.0), *, caching=True):
    system = SurfaceCoordinates(DOME, R_TE)
    context = system.CreateDefaultContext()
    if not caching:
        context.DisableCaching()
    system.GetInputPort("measured_pose").FixValue(context, [*quaternion, *position()])
    system.GetInputPort("measured_velocity").FixValue(context, VELOCITY)
    return [
        system.GetOutputPort(n).Eval(context)
        for n in ("coordinates", "orientation", "angular_velocity")
    ]


def test_ports_are_named_and_sized():
    system = SurfaceCoordinates(DOME, R_TE)
    assert system.get_name() == "surface_coordinates"
    assert system.GetInputPort("measured_pose").size() == 7
    assert system.GetOutputPort("coordinates").size() == 3
    assert system.GetOutputPort("orientation").size() == 4
    feedthrough = [
        [system.HasDirectFeedthrough(i, o) for o in range(3)] for i in range(2)
    ]
    assert feedthrough == [[True, True, True], [False, False, True]]


@pytest.mark.parametrize("caching", [True, False])
def test_outputs_are_those_of_the_surface(caching):
    coordinates, orientation, omega = outputs(caching=caching)
    assert_allclose(coordinates, UVH, atol=1e-12)
    expected = RotationMatrix(rotation(DOME, *UVH[:2])) @ R_TE
    assert_allclose(np.abs(orientation @ expected.ToQuaternion().wxyz()), 1, atol=1e-12)
    # The same orientation a moment later.
    moved = position() + 1e-5 * VELOCITY
    later = (
        RotationMatrix(rotation(DOME, *project(DOME, moved, np.zeros(2))[:2])) @ R_TE
    )
    turned = (later @ expected.inverse()).ToAngleAxis()
    assert_allclose(omega, turned.angle() * turned.axis() / 1e-5, atol=1e-3)


def test_orientation_of_the_tool_does_not_matter():
    turned = outputs((0.0, 1.0, 0.0, 0.0))
    for one, other in zip(turned, outputs(), strict=True):
        assert_allclose(one, other)


def test_forgotten_input_names_port_and_system():
    system = SurfaceCoordinates(DOME, R_TE)
    with pytest.raises(RuntimeError, match=r"measured_pose.*surface_coordinates"):
        system.GetOutputPort("coordinates").Eval(system.CreateDefaultContext())
