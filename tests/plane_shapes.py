"""Polygons in a plane, for the tests of ink."""

import numpy as np


def rectangle(centre, size, yaw=0.0):
    half = 0.5 * np.array(size)
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray(centre) + corners @ np.array([[c, -s], [s, c]]).T


def inside_convex(p, polygon):
    """Test points against a counterclockwise polygon, edge by edge."""
    inside = np.ones(len(p), dtype=bool)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        d, e = b - a, p - a
        inside &= d[0] * e[:, 1] - d[1] * e[:, 0] >= 0.0
    return inside
