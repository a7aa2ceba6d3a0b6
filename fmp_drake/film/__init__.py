"""Films of a run, rendered without a screen by Drake's VTK renderer through EGL.

A `FilmReel` keeps what is needed of a simulation while it runs; `film_run`, or
`render_film`, makes an .mp4 or a .gif of it afterwards. `check_film` refuses before the
run what cannot be made.
"""

from fmp_drake.film.camera import FilmCamera
from fmp_drake.film.checks import check_film
from fmp_drake.film.gauge import Gauge
from fmp_drake.film.overlay import Trail
from fmp_drake.film.reel import FilmReel
from fmp_drake.film.render import render_film, render_picture
from fmp_drake.film.run_film import FILM_SIGNALS, film_run, film_size

__all__ = [
    "FILM_SIGNALS",
    "FilmCamera",
    "FilmReel",
    "Gauge",
    "Trail",
    "check_film",
    "film_run",
    "film_size",
    "render_film",
    "render_picture",
]
