"""The film of one run of the wiping station."""

from pathlib import Path

from fmp_drake.film.camera import FilmCamera
from fmp_drake.film.overlay import Trail
from fmp_drake.film.reel import FilmReel
from fmp_drake.film.render import render_film
from fmp_drake.runs.wiping_run import WipingRun

FILM_SIGNALS = ("measured_position",)
"""Names of the signals that a run must keep for its film."""


def film_run(run: WipingRun, reel: FilmReel, path: Path, *, width: int) -> None:
    """Render the film of a run, as its scenario's camera sees it.

    Parameters
    ----------
    run : WipingRun
        Which has kept `FILM_SIGNALS`.
    reel : FilmReel
        That has watched the run.
    path : pathlib.Path
        Ends in .mp4 or .gif.
    width : int
        Pixels, 4 to 3.

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
        grid=run.grid,
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
    )


def film_size(width: int) -> tuple[int, int]:
    """Return width and height of a film, 4 to 3, pixels; the height is even."""
    return width, 2 * round(width * 3 / 8)
