"""Make the visual meshes of the arm: python models/ur5e/make_meshes.py [FOLDER].

Shapes of our own around the arm's joints: drums about the joints' axes, each with a
cap, and slender tubes between them. All lengths in m, in each link's frame; z of link n
is joint n's axis.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "shapes"))

from housing import Parts, cover, flange, ring, shell, write_meshes
from solid import bar, blend, common, cone, drum, half_space
from surface import Disc, turned

UPPER, FORE = -0.425, -0.3922  # Along x, to the next joint.
BESIDE, FOREARM = 0.138, 0.007  # Of the tubes' axes, along z.


def link0() -> Parts:
    """Shape the base: a low column on a round plate."""
    top = 0.082
    column = drum((0, 0, -0.03), (0, 0, top), 0.069, 0.010)
    skirt = cone((0, 0, -0.01), (0, 0, 0.040), 0.076, 0.066)
    body = blend(0.020, column, skirt)
    body = common(0.003, body, half_space((0, 0, 0.008), (0, 0, -1)))
    foot = [(0.0, 0.0745), (0.009, 0.0745), (0.011, 0.0725), (0.011, 0)]
    return [
        shell(
            body,
            (-0.10, -0.10, 0.0),
            (0.10, 0.10, top + 0.01),
            Disc((0, 0, 0.009), (0, 0, 1), 1),
            Disc((0, 0, top), (0, 0, 1), 0.056),
        ),
        ("metal", turned((0, 0, 0), (0, 0, 1), foot)),
        ring((0, 0, 0.085), (0, 0, 1), 0.062, 0.005),
        ring((-0.0735, 0, 0.042), (1, 0, 0), 0.012, 0.0025),
    ]


def link1() -> Parts:
    """Shape the shoulder: a drum about z and one about joint 2, each with its cap."""
    h, low, side = 0.1625, 0.088, 0.067
    upright = drum((0, 0, low), (0, 0, h + 0.062), 0.066, 0.007)
    across = drum((0, 0.050, h), (0, -side, h), 0.060, 0.007)
    body = blend(0.030, upright, across)
    body = common(0.005, body, half_space((0, 0, low), (0, 0, -1)))
    body = common(0.005, body, half_space((0, 0, h + 0.062), (0, 0, 1)))
    body = common(0.005, body, half_space((0, -side, 0), (0, -1, 0)))
    return [
        shell(
            body,
            (-0.09, -0.09, low - 0.01),
            (0.09, 0.09, h + 0.08),
            Disc((0, 0, low), (0, 0, 1), 0.055),
            Disc((0, 0, h + 0.062), (0, 0, 1), 0.058),
            Disc((0, -side, h), (0, 1, 0), 0.050),
        ),
        *cover((0, 0, h + 0.062), (0, 0, 1), 0.065, material="blue"),
        ring((0, -side - 0.003, h), (0, 1, 0), 0.055, 0.005),
    ]


def drums(
    length: float,
    tube: float,
    *,
    near: tuple[float, float],
    far: tuple[float, float],
    along: float,
    radii: tuple[float, float],
) -> Parts:
    """Shape a tube along -x between two drums about z.

    Parameters
    ----------
    length : float
        Position of the far drum on x.
    tube : float
        Radius of the tube.
    near, far : tuple of float
        Intervals of the drums along z.
    along : float
        Offset of the tube's axis along z.
    radii : tuple of float
        Of the drums.
    """
    ends = [(0.0, near, radii[0]), (length, far, radii[1])]
    solids = [drum((x, 0, a), (x, 0, b), r, 0.007) for x, (a, b), r in ends]
    solids.append(bar((0, 0, along), (length, 0, along), tube))
    solids.append(cone((0, 0, along), (0.30 * length, 0, along), 0.92 * radii[0], tube))
    solids.append(
        cone((length, 0, along), (0.75 * length, 0, along), 0.92 * radii[1], tube)
    )
    body = blend(0.025, *solids)
    low, high = min(near[0], far[0]), max(near[1], far[1])
    hidden = []
    for x, span, r in ends:
        for z in span:
            hidden.append(Disc((x, 0, z), (0, 0, 1), r - 0.010))
    return [
        shell(
            body,
            (length - radii[1] - 0.03, -radii[0] - 0.02, low - 0.01),
            (radii[0] + 0.03, radii[0] + 0.02, high + 0.01),
            *hidden,
        )
    ]


def link2() -> Parts:
    """Shape the upper arm, beside the shoulder."""
    return [
        *drums(
            UPPER,
            0.047,
            near=(0.073, 0.196),
            far=(0.075, 0.190),
            along=BESIDE,
            radii=(0.060, 0.056),
        ),
        *cover((0, 0, 0.196), (0, 0, 1), 0.059, material="blue"),
        *cover((UPPER, 0, 0.190), (0, 0, 1), 0.055, material="blue"),
        ring((UPPER, 0, 0.072), (0, 0, 1), 0.050, 0.005),
    ]


def link3() -> Parts:
    """Shape the forearm."""
    return [
        *drums(
            FORE,
            0.037,
            near=(-0.052, 0.069),
            far=(-0.040, 0.056),
            along=FOREARM,
            radii=(0.056, 0.044),
        ),
        *cover((0, 0, -0.052), (0, 0, -1), 0.055, material="blue"),
        *cover((FORE, 0, -0.040), (0, 0, -1), 0.043, edge=0.012, material="blue"),
        ring((FORE, 0, 0.059), (0, 0, 1), 0.038, 0.005),
    ]


def wrist(reach: float, side: int) -> Parts:
    """Shape a drum about z, crossed by one about the next joint, along y."""
    foot, top, end = 0.062, reach + 0.040, 0.046
    upright = drum((0, 0, foot), (0, 0, top), 0.042, 0.006)
    across = drum((0, 0, reach), (0, side * end, reach), 0.042, 0.006)
    body = blend(0.020, upright, across)
    body = common(0.005, body, half_space((0, 0, foot), (0, 0, -1)))
    body = common(0.005, body, half_space((0, 0, top), (0, 0, 1)))
    body = common(0.005, body, half_space((0, side * end, 0), (0, side, 0)))
    return [
        shell(
            body,
            (-0.06, -0.065, foot - 0.01),
            (0.06, 0.065, top + 0.01),
            Disc((0, 0, foot), (0, 0, 1), 0.032),
            Disc((0, 0, top), (0, 0, 1), 0.035),
            Disc((0, side * end, reach), (0, 1, 0), 0.032),
        ),
        *cover((0, 0, top), (0, 0, 1), 0.041, edge=0.012, bulge=0.004, material="blue"),
        ring((0, side * (end + 0.003), reach), (0, 1, 0), 0.037, 0.005),
    ]


def link4() -> Parts:
    """Shape the first part of the wrist."""
    return wrist(0.1333, -1)


def link5() -> Parts:
    """Shape the second part of the wrist."""
    return wrist(0.0997, 1)


def link6() -> Parts:
    """Shape the tool's flange."""
    body = drum((0, 0, 0.052), (0, 0, 0.088), 0.0395, 0.005)
    return [
        shell(
            body,
            (-0.06, -0.06, 0.04),
            (0.06, 0.06, 0.10),
            Disc((0, 0, 0.052), (0, 0, 1), 0.030),
        ),
        flange(0.087, 0.0996),
    ]


LINKS = [link0, link1, link2, link3, link4, link5, link6]


if __name__ == "__main__":
    write_meshes(LINKS, Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "meshes")
