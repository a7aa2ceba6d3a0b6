"""Films of a run, rendered without a screen by Drake's VTK renderer through EGL.

A `FilmReel` records what a film needs while a simulation runs; `film_run` makes an .mp4
or a .gif of it afterwards. `check_film` refuses an impossible film before the run.
"""

from fmp_drake.film.checks import check_film
from fmp_drake.film.reel import FilmReel
from fmp_drake.film.render import FILM_SIGNALS, film_run, film_size, render_picture

__all__ = [
    "FILM_SIGNALS",
    "FilmReel",
    "check_film",
    "film_run",
    "film_size",
    "render_picture",
]
