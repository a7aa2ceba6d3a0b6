"""Rendering films and pictures of a station from recorded positions and ink."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from pydrake.systems.framework import Diagram

from fmp_drake.errors import RunError
from fmp_drake.film.board_paint import BoardPaint
from fmp_drake.film.camera import FilmCamera
from fmp_drake.film.checks import check_film, check_renderer
from fmp_drake.film.encode import write_film
from fmp_drake.film.gauge import Gauge
from fmp_drake.film.overlay import (
    Trail,
    draw_caption,
    load_font,
    paint_trail,
)
from fmp_drake.film.scene import FilmScene
from fmp_drake.primitives.data.files import replaced
from fmp_drake.systems.ink.grid import InkGrid


def render_film(
    path: Path,
    *,
    station: Diagram,
    diagram: Diagram | None = None,
    grid: InkGrid,
    times: ArrayLike,
    positions: ArrayLike,
    ink: ArrayLike,
    fps: float,
    size: tuple[int, int] = (640, 480),
    camera: FilmCamera | None = None,
    trail: Trail | None = None,
    captions: Sequence[str] | None = None,
    gauges: Sequence[Gauge] = (),
    supersample: int = 1,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Render a film of a station without a screen; an existing file is replaced.

    Everything, also a board that moves, is drawn where the plant's positions put it.

    Parameters
    ----------
    path : pathlib.Path
        Ends in .mp4 or .gif.
    station : Diagram
        With subsystems plant and scene_graph; a frame `surface` of the plant is B.
    diagram : Diagram, optional
        The root diagram that contains the station; the station itself where None.
    grid : InkGrid
    times : array_like, shape (N,)
        Simulated time of each frame, s.
    positions : array_like, shape (N, nq)
        Of the plant.
    ink : array_like of uint8, shape (N, ny nx) or (N, ny, nx)
        Ink that is left in each cell, 0 for none to 255 for all.
    fps : float
        Frames per second of the film.
    size : tuple of int
        Width and height, pixels; even.
    camera : FilmCamera, optional
    trail : Trail, optional
        Path of the eraser; not drawn where None.
    captions : sequence of str, optional
        A line of text for each frame.
    gauges : sequence of Gauge
        Numbers of each frame, one below the other.
    supersample : int
        Pixels rendered for a pixel of the film, along each edge: smoother edges than
        the renderer's own, and two to three times the work at 2.
    track : callable
        Goes through the numbers of the frames, and may show how far it is.

    Raises
    ------
    RunError
        Where the film cannot be made; an existing file is then left as it was.
    """
    path = Path(path)
    check_film(path, fps=fps, size=size)
    moments, q, inks = _checked_frames(times, positions, ink, grid)
    if not 1 <= supersample <= 4:
        raise RunError(f"supersample is {supersample}; it must be from 1 to 4.")
    if captions is not None and len(captions) != len(moments):
        raise RunError(f"{len(captions)} captions for {len(moments)} frames.")
    for gauge in gauges:
        if np.shape(gauge.values) != moments.shape:
            raise RunError(
                f"the gauge {gauge.text!r} has values {np.shape(gauge.values)}; "
                f"expected {moments.shape}."
            )
    if trail is not None:
        trail.check()
    fine = (size[0] * supersample, size[1] * supersample)
    camera = camera or FilmCamera()
    scene = FilmScene(station, diagram=diagram, camera=camera, size=fine)
    board = BoardPaint(grid, rays=scene.rays)
    focal = camera.core("", fine).intrinsics().focal_x()
    font = load_font(size[1])

    def frame(i: int) -> NDArray[np.uint8]:
        shot = scene.render(q[i])
        seen = board.paint(shot, inks[i].reshape(grid.shape) / np.float32(255))
        if trail is not None:
            paint_trail(
                shot.color,
                trail.points(float(moments[i])),
                where=seen,
                X_CB=shot.X_CB,
                focal=focal,
                width=max(1, round(fine[1] / 220)),
            )
        picture = Image.fromarray(shot.color).reduce(supersample)
        if captions is not None:
            draw_caption(picture, captions[i], font=font)
        for row, gauge in enumerate(gauges):
            gauge.draw(picture, i, row=row, font=font)
        return np.asarray(picture)

    write_film(path, frame, len(q), fps=fps, track=track)


def render_picture(
    path: Path,
    *,
    station: Diagram,
    diagram: Diagram | None = None,
    grid: InkGrid,
    positions: ArrayLike,
    ink: ArrayLike,
    size: tuple[int, int] = (640, 480),
    camera: FilmCamera | None = None,
    supersample: int = 2,
) -> None:
    """Render one picture of a station without a screen; an existing file is replaced.

    Parameters
    ----------
    path : pathlib.Path
        In any format that Pillow writes.
    positions : array_like, shape (nq,)
        Of the plant.
    ink : array_like of uint8, shape (ny nx,) or (ny, nx)
        Ink that is left in each cell, 0 for none to 255 for all.
    station, diagram, grid, size, camera, supersample
        As for `render_film`.

    Raises
    ------
    RunError
        Where EGL does not work.
    """
    check_renderer()
    fine = (size[0] * supersample, size[1] * supersample)
    scene = FilmScene(
        station, diagram=diagram, camera=camera or FilmCamera(), size=fine
    )
    shot = scene.render(positions)
    blend = np.asarray(ink).reshape(grid.shape) / np.float32(255)
    BoardPaint(grid, rays=scene.rays).paint(shot, blend)
    with replaced(path, RunError) as part:
        Image.fromarray(shot.color).reduce(supersample).save(part)


def _checked_frames(
    times: ArrayLike, positions: ArrayLike, ink: ArrayLike, grid: InkGrid
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Return times (N,), positions (N, nq) and ink (N, ny nx) that fit together."""
    moments = np.asarray(times, dtype=float)
    q = np.asarray(positions, dtype=float)
    inks = np.asarray(ink)
    if inks.dtype != np.uint8:
        raise RunError(f"the ink of a film is {inks.dtype}; expected uint8, 255ths.")
    n = len(moments) if moments.ndim == 1 else 0
    if n == 0 or q.ndim != 2 or len(q) != n or inks.size != n * grid.num_cells:
        raise RunError(
            f"a film has times {moments.shape}, positions {q.shape} and ink "
            f"{inks.shape}; expected (N,), (N, nq) and (N, {grid.num_cells}), N > 0."
        )
    return moments, q, inks.reshape(n, -1)
