"""Showing a world of a store again."""

from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat, MeshcatParams
from threadpoolctl import threadpool_limits

from fmp_drake.errors import RunError
from fmp_drake.experiments.worlds.store import World
from fmp_drake.experiments.worlds.world import as_stored, make_run
from fmp_drake.film import FILM_SIGNALS, FilmReel, film_run
from fmp_drake.primitives.data.files import write_text

_FPS, _WIDTH = 20.0, 640


def replay_world(
    world: World, seconds: float, *, html: Path | None = None, video: Path | None = None
) -> dict[str, Any]:
    """Run a world again, bit-identically where code and machine are the same.

    Parameters
    ----------
    world : World
    seconds : float
        As long as it was run.
    html, video : pathlib.Path, optional
        What to show it with.

    Returns
    -------
    dict
        The metrics, as the store keeps them.
    """
    with threadpool_limits(limits=1):
        run = make_run(
            world.scenario,
            meshcat=None if html is None else Meshcat(MeshcatParams(host="localhost")),
            recording=html is not None,
            keep=FILM_SIGNALS if video is not None else (),
        )
        reel = FilmReel(run.station, fps=_FPS)
        if video is not None:
            reel.watch(run.simulator)
        run.advance_to(seconds)
        metrics = as_stored(run.metrics())
        run.remove_controls()
        if html is not None:
            write_text(html, run.html(), RunError)
        if video is not None:
            film_run(run, reel, video, width=_WIDTH)
    return metrics
