"""Rendering of films and pictures of a station from recorded positions and ink."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from pydrake.systems.framework import Diagram

from fmp_drake.errors import RunError
from fmp_drake.film.board_paint import BoardPaint
from fmp_drake.film.checks import check_film, check_renderer
from fmp_drake.film.encode import write_film
from fmp_drake.film.overlay import (
    Gauge,
    Trail,
    draw_caption,
    load_font,
    paint_trail,
)
from fmp_drake.film.reel import FilmReel
from fmp_drake.film.scene import FilmCamera, FilmScene
from fmp_drake.primitives.data.files import replaced
from fmp_drake.runs.metrics import NEAR_FORCE
from fmp_drake.runs.station_run import StationRun
from fmp_drake.runs.wiping_run import WipingRun
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.surface.surface import place

FILM_SIGNALS = ("measured_position", "normal_force")
"""Names of the signals that a run must keep for its film."""

_FINER = 2  # Pixels rendered for a pixel of a picture, along each edge.


def film_run(
    run: StationRun,
    reel: FilmReel,
    path: Path,
    *,
    width: int,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Render the film of a run, seen from the camera of its scenario.

    At a board it shows the normal force with its desired range, and the clean fraction of
    the demonstrated area.

    Parameters
    ----------
    run : StationRun
        That has kept `FILM_SIGNALS`.
    reel : FilmReel
        That has watched the run.
    path : pathlib.Path
        Ends in .mp4 or .gif.
    width : int
        Pixels, 4 to 3.
    track : callable
        Goes through the numbers of the frames, and may show how far it is.

    Raises
    ------
    RunError
        Where the film cannot be made; an existing file is then left as it was.
    """
    camera = run.scenario.camera
    speed = f", {reel.speed:g} times as fast" if reel.speed != 1 else ""
    render_film(
        path,
        station=run.station,
        diagram=run.diagram,
        grid=run.grid if isinstance(run, WipingRun) else None,
        times=reel.times,
        positions=reel.positions,
        ink=reel.ink,
        fps=reel.fps,
        size=film_size(width),
        camera=FilmCamera(eye=camera.eye, target=camera.target),
        trail=Trail(
            times=run.log_times("measured_position"),
            positions=run.log("measured_position"),
        ),
        captions=[f"{time:.0f} s{speed}" for time in reel.times],
        gauges=_gauges(run, reel.times) if isinstance(run, WipingRun) else [],
        track=track,
    )


def _gauges(run: WipingRun, times: NDArray[np.float64]) -> list[Gauge]:
    """Return the gauges of the normal force and the clean fraction."""
    desired = run.scenario.press.force
    low, high = max(0.0, desired - NEAR_FORCE), desired + NEAR_FORCE
    force = np.interp(
        times, run.log_times("normal_force"), run.log("normal_force")[:, 0]
    )
    cleaned = 100 * run.cleaned_by(times)
    return [
        Gauge(
            text=f"force {{:.1f}} N (wanted {low:g} to {high:g})",
            values=force,
            most=high + NEAR_FORCE,
            band=(low, high),
        ),
        Gauge(text="cleaned {:.0f} %", values=cleaned, most=100.0),
    ]


def film_size(width: int) -> tuple[int, int]:
    """Return width and height of a film, 4 to 3, pixels; the height is even."""
    return width, 2 * round(width * 3 / 8)


def render_film(
    path: Path,
    *,
    station: Diagram,
    diagram: Diagram | None = None,
    grid: InkGrid | None,
    times: ArrayLike,
    positions: ArrayLike,
    ink: ArrayLike,
    fps: float,
    size: tuple[int, int] = (640, 480),
    camera: FilmCamera,
    trail: Trail | None = None,
    captions: Sequence[str] | None = None,
    gauges: Sequence[Gauge] = (),
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
    grid : InkGrid or None
        None in free space, where the reel has no ink and the trail is not on a board.
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
    camera : FilmCamera
    trail : Trail, optional
        Path of the eraser; not drawn where None.
    captions : sequence of str, optional
        A line of text for each frame.
    gauges : sequence of Gauge
        Numbers of each frame, one below the other.
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
    scene = FilmScene(station, diagram=diagram, camera=camera, size=size)
    board = None if grid is None else BoardPaint(grid, rays=scene.rays)
    focal = camera.core("", size).intrinsics().focal_x()
    font = load_font(size[1])

    def frame(i: int) -> NDArray[np.uint8]:
        shot = scene.render(q[i])
        visible, points = np.ones(shot.depth.shape, dtype=bool), np.zeros((0, 3))
        if trail is not None:
            points = trail.points(float(moments[i]), on_board=grid is not None)
        if grid is not None and board is not None:
            visible = board.paint(shot, inks[i].reshape(grid.shape) / np.float32(255))
            points = place(grid.curvature, points)
        if trail is not None:
            paint_trail(
                shot.color,
                points,
                where=visible,
                X_CB=shot.X_CB,
                focal=focal,
                width=max(1, round(size[1] / 220)),
            )
        picture = Image.fromarray(shot.color)
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
    grid: InkGrid | None,
    positions: ArrayLike,
    ink: ArrayLike,
    size: tuple[int, int] = (640, 480),
    camera: FilmCamera,
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
    station, diagram, grid, size, camera
        As for `render_film`.

    Raises
    ------
    RunError
        Where EGL does not work.
    """
    check_renderer()
    fine = (size[0] * _FINER, size[1] * _FINER)
    scene = FilmScene(station, diagram=diagram, camera=camera, size=fine)
    shot = scene.render(positions)
    if grid is not None:
        blend = np.asarray(ink).reshape(grid.shape) / np.float32(255)
        BoardPaint(grid, rays=scene.rays).paint(shot, blend)
    with replaced(path, RunError) as part:
        Image.fromarray(shot.color).reduce(_FINER).save(part)


def _checked_frames(
    times: ArrayLike, positions: ArrayLike, ink: ArrayLike, grid: InkGrid | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Return times (N,), positions (N, nq) and ink (N, ny nx) that fit together."""
    moments = np.asarray(times, dtype=float)
    q = np.asarray(positions, dtype=float)
    inks = np.asarray(ink)
    if inks.dtype != np.uint8:
        raise RunError(f"the ink of a film is {inks.dtype}; expected uint8, 255ths.")
    n = len(moments) if moments.ndim == 1 else 0
    cells = 0 if grid is None else grid.num_cells
    if n == 0 or q.ndim != 2 or len(q) != n or inks.size != n * cells:
        raise RunError(
            f"a film has times {moments.shape}, positions {q.shape} and ink "
            f"{inks.shape}; expected (N,), (N, nq) and (N, {cells}), N > 0."
        )
    return moments, q, inks.reshape(n, cells)
