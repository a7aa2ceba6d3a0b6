"""Make the visual meshes of the arm: python models/iiwa14/make_meshes.py [FOLDER].

Shapes of our own around the arm's joints. All lengths in m, in each link's frame, whose
axes are those of the world while all angles are 0: the joints turn about z and y
alternately.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "shapes"))

from housing import Parts, cover, flange, ring, shell, write_meshes
from solid import blend, block, carve, common, cone, drum, half_space
from surface import Disc, plate, turned

GAP = 0.005  # Half of the dark gap between two links.
SHELL = {"material": "silver", "step": 0.0045}


def knuckle(
    end: float,
    joint: float,
    side: int,
    *,
    tube: float,
    radius: float,
    out: float,
    cap: str = "silver",
) -> Parts:
    """Shape a tube about z that ends as one half of a joint about y.

    Parameters
    ----------
    end, joint : float
        Heights of the tube's open end and of the joint's axis.
    side : {1, -1}
        The half of the joint, along y.
    tube, radius : float
        Radii of the tube and of the joint.
    out : float
        Distance of the joint's cover from z.
    cap : str
        Material of the cover.
    """
    up = 1 if joint > end else -1
    height = abs(joint - end)
    middle = end + up * min(0.45 * height, height - radius)
    column = drum((0, 0, end), (0, 0, middle), tube, 0.008)
    lean = cone(
        (0, 0.1 * side * tube, middle - up * 0.015),
        (0, 0.58 * side * out, joint - up * 0.1 * radius),
        0.97 * tube,
        0.95 * radius,
    )
    half = drum((0, -0.3 * side * out, joint), (0, side * out, joint), radius, 0.005)
    other = drum(
        (0, 0.003 * side, joint), (0, -2 * side * out, joint), radius + 0.004, 0.004
    )
    body = carve(0.010, blend(0.035, column, lean, half), other)
    body = common(0.005, body, half_space((0, side * out, 0), (0, side, 0)))
    body = common(0.004, body, half_space((0, 0, end), (0, 0, -up)))
    low, high = min(end, joint - radius), max(end, joint + radius)
    return [
        shell(
            body,
            (-radius - 0.02, -out - 0.02, low - 0.01),
            (radius + 0.02, out + 0.02, high + 0.01),
            Disc((0, 0, end), (0, 0, 1), tube - 0.009),
            Disc((0, 0.003 * side, joint), (0, 1, 0), radius - 0.008),
            Disc((0, side * out, joint), (0, 1, 0), radius - 0.006),
            **SHELL,
        ),
        ring((0, 0, joint), (0, 1, 0), radius - 0.003),
        *cover((0, side * out, joint), (0, side, 0), radius, material=cap),
    ]


def neck(height: float, radius: float) -> Parts:
    """Return the dark gap between two tubes about z, with an orange line on it."""
    band = [(-0.0012, radius + 0.0005), (0.0012, radius + 0.0005)]
    return [
        ring((0, 0, height), (0, 0, 1), radius, GAP + 0.001),
        ("orange", turned((0, 0, height), (0, 0, 1), band)),
    ]


def link0() -> Parts:
    """Shape the base: a column and a connector box on a plate."""
    top = 0.1575 - GAP
    column = drum((0, 0, -0.03), (0, 0, top), 0.079, 0.009)
    skirt = cone((0, 0, -0.01), (0, 0, 0.075), 0.098, 0.076)
    rear = block((-0.085, 0, 0.030), (0.075, 0.060, 0.052), 0.026)
    body = blend(0.035, column, skirt, rear)
    body = common(0.003, body, half_space((0, 0, 0.010), (0, 0, -1)))
    foot = plate(
        [(0, 0, 0.112), (-0.130, 0.048, 0.038), (-0.130, -0.048, 0.038)],
        top=0.015,
        edge=0.005,
    )
    return [
        shell(
            body,
            (-0.18, -0.13, 0.0),
            (0.13, 0.13, top + 0.01),
            Disc((0, 0, 0.011), (0, 0, 1), 1),
            Disc((0, 0, top), (0, 0, 1), 0.062),
            **SHELL,
        ),
        ("silver", foot),
        *neck(0.1575, 0.072),
        ring((-0.1605, 0, 0.046), (1, 0, 0), 0.018, 0.0015),
    ]


def link1() -> Parts:
    """Shape the column and the near half of the shoulder."""
    return knuckle(GAP, 0.2025, -1, tube=0.077, radius=0.079, out=0.096)


def link2() -> Parts:
    """Shape the far half of the shoulder and the upper arm's root."""
    parts = knuckle(
        0.2045 - GAP, 0, 1, tube=0.074, radius=0.079, out=0.096, cap="orange"
    )
    return [*parts, *neck(0.2045, 0.068)]


def link3() -> Parts:
    """Shape the upper arm and the near half of the elbow."""
    return knuckle(GAP, 0.2155, 1, tube=0.074, radius=0.070, out=0.088)


def link4() -> Parts:
    """Shape the far half of the elbow and the forearm's root."""
    parts = knuckle(
        0.1845 - GAP, 0, -1, tube=0.066, radius=0.070, out=0.088, cap="orange"
    )
    return [*parts, *neck(0.1845, 0.060)]


def link5() -> Parts:
    """Shape the forearm and the near half of the wrist."""
    return knuckle(GAP, 0.2155, -1, tube=0.066, radius=0.056, out=0.074)


def link6() -> Parts:
    """Shape the far half of the wrist and the head over joint 7."""
    parts = knuckle(
        0.081 - GAP, 0, 1, tube=0.052, radius=0.056, out=0.074, cap="orange"
    )
    return [*parts, *neck(0.081, 0.047)]


def link7() -> Parts:
    """Shape the last disc with its flange."""
    body = drum((0, 0, GAP), (0, 0, 0.029), 0.050, 0.006)
    return [
        shell(
            body,
            (-0.07, -0.07, -0.01),
            (0.07, 0.07, 0.04),
            Disc((0, 0, GAP), (0, 0, 1), 0.040),
            **SHELL,
        ),
        flange(0.028, 0.045),
    ]


LINKS = [link0, link1, link2, link3, link4, link5, link6, link7]


if __name__ == "__main__":
    write_meshes(LINKS, Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "meshes")
