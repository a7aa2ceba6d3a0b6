"""The film of one run of the wiping station."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from fmp_drake.film.camera import FilmCamera
from fmp_drake.film.gauge import Gauge
from fmp_drake.film.overlay import Trail
from fmp_drake.film.reel import FilmReel
from fmp_drake.film.render import render_film
from fmp_drake.runs.metrics import NEAR_FORCE
from fmp_drake.runs.wiping_run import WipingRun

FILM_SIGNALS = ("measured_position", "normal_force")
"""Names of the signals that a run must keep for its film."""


def film_run(
    run: WipingRun,
    reel: FilmReel,
    path: Path,
    *,
    width: int,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Render the film of a run, as its scenario's camera sees it.

    It shows the normal force with the band in which it should be, and how much of the
    demonstrated area is clean.

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
    track : callable
        Goes through the numbers of the frames, and may show how far it is.

    Raises
    ------
    RunError
        Where the film cannot be made; an existing file is then left as it was.
    """
    camera = run.scenario.camera
    wanted = run.scenario.press.force
    low, high = max(0.0, wanted - NEAR_FORCE), wanted + NEAR_FORCE
    force = np.interp(
        reel.times, run.log_times("normal_force"), run.log("normal_force")[:, 0]
    )
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
        gauges=[
            Gauge(
                text=f"force {{:.1f}} N (wanted {low:g} to {high:g})",
                values=force,
                most=high + NEAR_FORCE,
                band=(low, high),
            ),
            Gauge(
                text="cleaned {:.0f} %",
                values=100 * run.cleaned_by(reel.times),
                most=100.0,
            ),
        ],
        track=track,
    )


def film_size(width: int) -> tuple[int, int]:
    """Return width and height of a film, 4 to 3, pixels; the height is even."""
    return width, 2 * round(width * 3 / 8)
