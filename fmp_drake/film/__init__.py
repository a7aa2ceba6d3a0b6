"""Films of a run, rendered without a screen by Drake's VTK renderer through EGL.

A `FilmReel` records positions and ink during a simulation; `film_run` then makes an .mp4
or a .gif. `check_film` checks the settings of a film before the run.
"""

from fmp_drake.film.render import (
    FILM_SIGNALS,
    FilmReel,
    check_film,
    film_run,
    film_size,
    render_picture,
)

__all__ = [
    "FILM_SIGNALS",
    "FilmReel",
    "check_film",
    "film_run",
    "film_size",
    "render_picture",
]
