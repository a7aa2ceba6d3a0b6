"""Make the visual meshes of the arm: python models/panda/make_meshes.py [FOLDER].

Shapes of our own around the arm's joints: shells blended from bars and drums, dark
rings where the links meet. All lengths in m, in each link's frame; z of link n is
joint n's axis.
"""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "shapes"))

from housing import Parts, cover, flange, ring, shell, write_meshes
from solid import bar, blend, block, carve, common, cone, drum, half_space
from surface import Disc, plate, turned


def link0() -> Parts:
    """Shape the base: a column and a connector box on a plate."""
    column = drum((0, 0, -0.03), (0, 0, 0.133), 0.069, 0.009)
    skirt = cone((0, 0, -0.01), (0, 0, 0.055), 0.080, 0.066)
    rear = block((-0.068, 0, 0.020), (0.062, 0.056, 0.062), 0.028)
    body = blend(0.035, column, skirt, rear)
    body = common(0.003, body, half_space((0, 0, 0.008), (0, 0, -1)))
    foot = plate(
        [(0, 0, 0.095), (-0.105, 0.048, 0.034), (-0.105, -0.048, 0.034)],
        top=0.013,
        edge=0.005,
    )
    return [
        shell(
            body,
            (-0.15, -0.11, 0.0),
            (0.11, 0.11, 0.14),
            Disc((0, 0, 0.009), (0, 0, 1), 1),
            Disc((0, 0, 0.133), (0, 0, 1), 0.054),
        ),
        ("white", foot),
        ring((0, 0, 0.1365), (0, 0, 1), 0.0615, 0.006),
        (
            "light",
            turned((0, 0, 0.112), (0, 0, 1), [(-0.0016, 0.0693), (0.0016, 0.0693)]),
        ),
        ring((-0.1305, 0, 0.038), (1, 0, 0), 0.015, 0.0015),
    ]


def link1() -> Parts:
    """Shape the column and the near half of the shoulder."""
    r, end = 0.0625, -0.084
    column = drum((0, 0, -0.1905), (0, 0, -0.05), 0.061, 0.008)
    lean = cone((0, -0.004, -0.105), (0, -0.046, -0.004), 0.060, 0.060)
    half = drum((0, 0.03, 0), (0, end, 0), r, 0.005)
    other = drum((0, -0.0025, 0), (0, 0.12, 0), r + 0.004, 0.004)
    body = carve(0.010, blend(0.035, column, lean, half), other)
    body = common(0.005, body, half_space((0, end, 0), (0, -1, 0)))
    return [
        shell(
            body,
            (-0.08, -0.13, -0.2),
            (0.08, 0.08, 0.08),
            Disc((0, 0, -0.1905), (0, 0, 1), 0.052),
            Disc((0, -0.0025, 0), (0, 1, 0), 0.055),
            Disc((0, end, 0), (0, 1, 0), 0.056),
        ),
        ring((0, 0, 0), (0, 1, 0), r - 0.003),
        *cover((0, end, 0), (0, -1, 0), r),
    ]


def link2() -> Parts:
    """Shape the far half of the shoulder and the upper arm's root."""
    r, end = 0.0625, 0.084
    column = drum((0, -0.05, 0), (0, -0.142, 0), 0.060, 0.008)
    lean = cone((0, -0.100, 0.004), (0, -0.004, 0.046), 0.059, 0.060)
    half = drum((0, 0, -0.03), (0, 0, end), r, 0.005)
    other = drum((0, 0, 0.0025), (0, 0, -0.12), r + 0.004, 0.004)
    body = carve(0.010, blend(0.035, column, lean, half), other)
    body = common(0.005, body, half_space((0, 0, end), (0, 0, 1)))
    return [
        shell(
            body,
            (-0.08, -0.15, -0.08),
            (0.08, 0.08, 0.13),
            Disc((0, -0.142, 0), (0, 1, 0), 0.051),
            Disc((0, 0, 0.0025), (0, 0, 1), 0.055),
            Disc((0, 0, end), (0, 0, 1), 0.056),
        ),
        ring((0, -0.145, 0), (0, 1, 0), 0.056, 0.005),
        *cover((0, 0, end), (0, 0, 1), r),
    ]


def link3() -> Parts:
    """Shape the upper arm and the near half of the elbow."""
    r, x, end = 0.0585, 0.0825, 0.080
    tube = drum((0, 0, -0.168), (0, 0, -0.08), 0.060, 0.008)
    bend = cone((0.004, 0.002, -0.118), (0.058, 0.030, -0.036), 0.058, 0.056)
    half = drum((x, -0.03, 0), (x, end, 0), r, 0.005)
    other = drum((x, 0.0025, 0), (x, -0.12, 0), r + 0.004, 0.004)
    neck = bar((0.058, 0.030, -0.036), (x, 0.040, 0.0), 0.055)
    body = carve(0.010, blend(0.04, tube, bend, blend(0.02, neck, half)), other)
    body = common(0.005, body, half_space((x, end, 0), (0, 1, 0)))
    return [
        shell(
            body,
            (-0.08, -0.08, -0.18),
            (0.16, 0.13, 0.08),
            Disc((0, 0, -0.168), (0, 0, 1), 0.051),
            Disc((x, 0.0025, 0), (0, 1, 0), 0.051),
            Disc((x, end, 0), (0, 1, 0), 0.052),
        ),
        ring((x, 0, 0), (0, 1, 0), r - 0.003),
        *cover((x, end, 0), (0, 1, 0), r),
    ]


def link4() -> Parts:
    """Shape the far half of the elbow and the forearm's root."""
    r, x, end = 0.0585, -0.0825, 0.080
    tube = drum((x, 0.07, 0), (x, 0.1555, 0), 0.0575, 0.008)
    bend = cone((-0.022, 0.032, 0.030), (-0.078, 0.108, 0.003), 0.055, 0.056)
    half = drum((0, 0, -0.03), (0, 0, end), r, 0.005)
    other = drum((0, 0, 0.0025), (0, 0, -0.12), r + 0.004, 0.004)
    neck = bar((0, 0, 0.040), (-0.022, 0.032, 0.030), 0.055)
    body = carve(0.010, blend(0.04, tube, bend, blend(0.02, neck, half)), other)
    body = common(0.005, body, half_space((0, 0, end), (0, 0, 1)))
    return [
        shell(
            body,
            (-0.16, -0.08, -0.08),
            (0.08, 0.17, 0.13),
            Disc((x, 0.1555, 0), (0, 1, 0), 0.048),
            Disc((0, 0, 0.0025), (0, 0, 1), 0.051),
            Disc((0, 0, end), (0, 0, 1), 0.052),
        ),
        ring((x, 0.1575, 0), (0, 1, 0), 0.0535, 0.004),
        *cover((0, 0, end), (0, 0, 1), r),
    ]


def link5() -> Parts:
    """Shape the forearm, thinning to one side of the wrist."""
    r, end = 0.0505, 0.088
    tube = drum((0, 0, -0.2255), (0, 0, -0.185), 0.0575, 0.008)
    taper = cone((0, 0.004, -0.190), (0, 0.050, -0.095), 0.055, 0.042)
    arm = cone((0, 0.058, -0.120), (0, 0.066, -0.020), 0.040, 0.036)
    half = drum((0, 0.02, 0), (0, end, 0), r, 0.005)
    other = drum((0, 0.0395, 0), (0, -0.12, 0), r + 0.004, 0.004)
    body = carve(0.010, blend(0.05, tube, taper, arm, half), other)
    trim = common(0.005, body, half_space((0, end, 0), (0, 1, 0)))
    return [
        shell(
            trim,
            (-0.08, -0.08, -0.24),
            (0.08, 0.13, 0.08),
            Disc((0, 0, -0.2255), (0, 0, 1), 0.048),
            Disc((0, 0.0395, 0), (0, 1, 0), 0.042),
            Disc((0, end, 0), (0, 1, 0), 0.044),
        ),
        ring((0, 0.037, 0), (0, 1, 0), r - 0.003),
        *cover((0, end, 0), (0, 1, 0), r, edge=0.014, bulge=0.004),
    ]


def link6() -> Parts:
    """Shape the other side of the wrist and the head over joint 7."""
    r, x, side, top = 0.0505, 0.088, 0.040, 0.044
    wrist = drum((0, 0, -0.0345), (0, 0, side), r, 0.006)
    arm = cone((0.012, 0.0, 0.004), (0.072, 0.004, 0.0), 0.044, 0.045)
    head = drum((x, -0.0455, 0), (x, top, 0), 0.0475, 0.006)
    body = blend(0.035, wrist, arm, head)
    for point, normal in (
        ((x, -0.0455, 0), (0, -1, 0)),
        ((x, top, 0), (0, 1, 0)),
        ((0, 0, -0.0345), (0, 0, -1)),
        ((0, 0, side), (0, 0, 1)),
    ):
        body = common(0.006, body, half_space(point, normal))
    return [
        shell(
            body,
            (-0.07, -0.07, -0.07),
            (0.15, 0.09, 0.08),
            Disc((x, -0.0455, 0), (0, 1, 0), 0.038),
            Disc((x, top, 0), (0, 1, 0), 0.041),
            Disc((0, 0, -0.0345), (0, 0, 1), 0.041),
            Disc((0, 0, side), (0, 0, 1), 0.044),
        ),
        ring((x, -0.048, 0), (0, 1, 0), 0.0435, 0.0045),
        *cover((0, 0, side), (0, 0, 1), r, edge=0.014, bulge=0.004),
        *cover((x, top, 0), (0, 1, 0), 0.0475, edge=0.011, bulge=0.003),
    ]


def link7() -> Parts:
    """Shape the wrist with its grip and the flange."""
    s = np.sqrt(0.5)
    wrist = drum((0, 0, 0.0505), (0, 0, 0.0895), 0.0465, 0.007)
    grip = bar((0.02 * s, 0.02 * s, 0.071), (0.052 * s, 0.052 * s, 0.073), 0.0165)
    body = blend(0.02, wrist, grip)
    body = common(0.008, body, half_space((0.060 * s, 0.060 * s, 0), (s, s, 0)))
    return [
        shell(
            body,
            (-0.06, -0.06, 0.04),
            (0.08, 0.08, 0.1),
            Disc((0, 0, 0.0505), (0, 0, 1), 0.038),
        ),
        flange(0.089, 0.107),
        ring((0.0595 * s, 0.0595 * s, 0.0732), (s, s, 0), 0.0105, 0.0015),
    ]


LINKS = [link0, link1, link2, link3, link4, link5, link6, link7]


if __name__ == "__main__":
    write_meshes(LINKS, Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "meshes")
