"""Placing a demonstration that was recorded anywhere onto a board."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives.data.demonstration import Demonstration

_TRIES = 1000
_ENOUGH = 2000  # samples, to tell one plane from another
_WIDTHS = (0.003, 3.0)  # m, of a path that an arm can follow
_GUESSES = {"millimetres": ("mm", 1e-3), "centimetres": ("cm", 1e-2)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Placement:
    """A similarity from the frame D of a demonstration to the board's frame B.

    p_BE = scale * R_BD p_DE + p_BD.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        R_BD.
    translation : ndarray, shape (3,)
        p_BD, m.
    scale : float
    touch : float
        Heights up to this one become 0, and greater ones are reduced by it, m: a hand
        does not keep a tool on the surface to the millimetre. 0 leaves all heights as
        they are.
    touching : float
        Fraction of the samples that become 0.

    Examples
    --------
    >>> recorded = Demonstration(
    ...     time=np.arange(100) / 20, values=np.random.default_rng(0).random((100, 3))
    ... )
    >>> placement = Placement(rotation=np.eye(3), translation=np.array([0.0, 0.0, 0.1]))
    >>> (placement.apply(recorded).values - recorded.values)[0].round(6)
    array([0. , 0. , 0.1])
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    scale: float = 1.0
    touch: float = 0.0
    touching: float = 0.0

    def apply(self, demonstration: Demonstration) -> Demonstration:
        """Return the demonstration in the frame of the board."""
        values = demonstration.values @ (self.scale * self.rotation).T
        values += self.translation
        if self.touch > 0:
            values[:, 2] = np.maximum(values[:, 2] - self.touch, 0.0)
        return replace(
            demonstration, values=values, channels=("x", "y", "z"), frame="board"
        )


def check_width(demonstration: Demonstration) -> None:
    """Refuse a path x, y, z that no arm can follow, and guess what its unit is.

    Raises
    ------
    DemonstrationError
        Where it is more than 3 m wide, or less than 3 mm.
    """
    width = float(np.max(np.ptp(demonstration.select(["x", "y", "z"]).values, axis=0)))
    if width == 0 or _WIDTHS[0] <= width <= _WIDTHS[1]:  # A point is refused later.
        return
    guess = "check its unit (--unit) and its columns (--columns)"
    for name, (unit, factor) in _GUESSES.items():
        if 0.03 <= width * factor <= _WIDTHS[1]:
            guess = f"{name}? Give --unit {unit}"
            break
    raise DemonstrationError(f"the path is {width:.3g} m wide: {guess}.")


def fit_placement(
    demonstration: Demonstration, *, usable: ArrayLike, touch: float = 0.01
) -> Placement:
    """Find how to lay a recorded path flat onto the middle of a board.

    The plane near which the tool stays longest becomes the surface; where the path
    leaves it, it leaves upwards. The board's x axis is the recording's x axis,
    projected (its y axis where x is nearly normal to the plane). The middle of the
    path's bounding box comes to the middle of the board, and a path that is too large
    is scaled down to the usable size.

    Parameters
    ----------
    demonstration : Demonstration
        Of 3 position channels, m, in any frame.
    usable : array_like, shape (2,)
        Greatest extent of the path along the board's x and y, m.
    touch : float
        A sample this near to the plane is on it, m.

    Raises
    ------
    DemonstrationError
        Where the samples have no 3 channels, or all lie on a line.
    """
    points = demonstration.values
    if points.shape[1] != 3:
        raise DemonstrationError(
            f"the demonstration has {points.shape[1]} channels; a path to lay onto a "
            "board needs 3 (x, y, z)."
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * max(spread[0], 1e-12):
        raise DemonstrationError(
            "the demonstration stays on a point or a line, so its plane is not "
            "determined; give the transform to the board instead."
        )
    centre, normal = _longest_plane(points, touch)
    forward = np.eye(3)[1 if abs(normal[0]) > 0.9 else 0]
    x = forward - (forward @ normal) * normal
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(normal, x), normal])
    flat = (points - centre) @ rotation.T
    low, high = flat[:, :2].min(axis=0), flat[:, :2].max(axis=0)
    extent = np.maximum(high - low, 1e-9)
    scale = float(min(1.0, np.min(np.asarray(usable, dtype=float) / extent)))
    middle = np.array([*(low + high) / 2, 0.0])
    return Placement(
        rotation=rotation,
        translation=-scale * (rotation @ centre + middle),
        scale=scale,
        touch=scale * touch,
        touching=float(np.mean(flat[:, 2] <= touch)),
    )


def _longest_plane(
    points: NDArray[np.float64], touch: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find a point of and the normal to the plane that most samples touch.

    Planes through three samples are tried (RANSAC, from a fixed seed); samples
    beyond the plane count against it. The best is fitted to the samples on it.
    """
    points = points[:: len(points) // _ENOUGH + 1]
    rng = np.random.default_rng(0)
    triples = points[rng.integers(len(points), size=(_TRIES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    keep = lengths > 1e-3 * np.max(lengths)
    normals = normals[keep] / lengths[keep, None]
    normals = np.concatenate([normals, -normals])
    origins = np.concatenate([triples[keep, 0]] * 2)
    heights = points @ normals.T - np.einsum("ij,ij->i", origins, normals)
    score = np.sum(np.abs(heights) <= touch, axis=0) - np.sum(heights < -touch, axis=0)
    # Of planes as good as each other, the one whose normal points up.
    best = int(np.argmax(score + 1e-3 * normals[:, 2]))
    on = points[np.abs(heights[:, best]) <= touch]
    centre = on.mean(axis=0)
    # The direction of least scatter; a full SVD would build an N x N array.
    normal = np.linalg.eigh((on - centre).T @ (on - centre))[1][:, 0]
    return centre, normal * np.sign(normal @ normals[best])
