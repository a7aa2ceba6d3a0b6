"""Facts about the path in a recording of Meshcat."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.geometry import Meshcat, Rgba, Sphere

from fmp_drake.systems.viewer import path_recording
from fmp_drake.systems.viewer.path_recording import AddPathToRecording


@pytest.mark.parametrize("seconds", [0.1, 4.0, 1000.0])
def test_each_part_of_a_path_is_seen_when_it_has_been_gone_along(seconds, monkeypatch):
    lines, since = {}, {}
    monkeypatch.setattr(
        path_recording,
        "draw_line",
        lambda _, path, points, **__: lines.update({path: points}),
    )
    monkeypatch.setattr(
        path_recording,
        "show_during",
        lambda _, path, **when: since.update({path: when["since"]}),
    )
    meshcat = Meshcat()
    meshcat.StartRecording()
    meshcat.StopRecording()
    times = np.linspace(0.0, seconds, 1001)
    points = np.column_stack([times, np.sin(times), 0 * times])
    AddPathToRecording(
        meshcat, "path", times=times, points=points, color=Rgba(1, 0, 0, 1)
    )
    parts = list(lines.values())
    assert 1 <= len(parts) <= 300
    for part, when in zip(parts, since.values(), strict=True):
        assert part[-1, 0] == when <= part[0, 0] + max(0.26, seconds / 250)
    for a, b in pairwise(parts):
        np.testing.assert_array_equal(a[-1], b[0])
    np.testing.assert_array_equal(parts[0][0], points[0])
    np.testing.assert_array_equal(parts[-1][-1], points[-1])


def test_a_path_of_one_point_leaves_nothing_of_an_older_one():
    meshcat = Meshcat()
    meshcat.SetObject("path/0", Sphere(0.1))
    AddPathToRecording(
        meshcat, "path", times=[0.0], points=np.zeros((1, 3)), color=Rgba(1, 0, 0, 1)
    )
    assert not meshcat.HasPath("path")
