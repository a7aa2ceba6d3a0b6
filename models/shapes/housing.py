"""The housing of an arm: shells of its links, rings between them, covers on their ends.

The scripts `make_meshes.py` of the arms use it (NumPy only). All lengths in m.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from gltf import write_gltf
from surface import Disc, Mesh, skin, turned, without

Parts = list[tuple[str, Mesh]]


def ring(centre, axis, radius, half=0.004):
    """Return a closed ring, as seen in the gap between two links."""
    profile = [(-half, 0), (-half, radius), (half, radius), (half, 0)]
    return "dark", turned(centre, axis, profile)


def cover(centre, axis, radius, *, edge=0.017, bulge=0.006, material="white"):
    """Return the round cover on the end of a drum, with a fine gap under it."""
    angles = np.linspace(0, 1.32, 6)
    height = 0.006 + edge * np.sin(angles)
    rim = radius - edge + edge * np.cos(angles)
    top = rim[-1] * np.array([0.66, 0.33, 0.0])
    crown = height[-1] + bulge * (1 - (top / rim[-1]) ** 2)
    profile = [(0.0, radius - 0.0035), (0.002, radius - 0.001), (0.0035, radius)]
    profile += [*zip(height, rim, strict=True), *zip(crown, top, strict=True)]
    groove = [(-0.004, radius - 0.0035), (0.001, radius - 0.0035)]
    return [
        (material, turned(centre, axis, profile, smooth=50)),
        ("seam", turned(centre, axis, groove)),
    ]


def flange(foot, top):
    """Return the flange for a tool, a disc about z between two heights."""
    rim = [(foot, 0.0315), (top - 0.0008, 0.0315), (top, 0.0307)]
    profile = [(foot, 0.0), *rim, (top, 0.0)]
    return "metal", turned((0, 0, 0), (0, 0, 1), profile)


def shell(solid, low, high, *hidden: Disc, material="white", step=0.0036):
    """Return the skin of a solid in a box, without the triangles that other parts hide.

    `step` is the side of the cubes of the grid that finds the surface.
    """
    return material, without(skin(solid, low, high, step=step), list(hidden))


def write_meshes(links: Sequence[Callable[[], Parts]], folder: Path) -> None:
    """Write one file for each link, and report its size."""
    folder.mkdir(parents=True, exist_ok=True)
    total = 0
    for make in links:
        path = folder / f"{make.__name__}.gltf"
        count = write_gltf(path, make())
        total += count
        size = path.stat().st_size / 1e3
        sys.stdout.write(f"{path.name}: {count} triangles, {size:.0f} kB\n")
    sys.stdout.write(f"{total} triangles\n")
