"""Films and pictures of a station, from recorded positions and ink."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydrake.systems.framework import Context, Diagram

from fmp_drake.errors import RunError
from fmp_drake.film.encode import ffmpeg_program, write_film
from fmp_drake.film.scene import (
    FilmScene,
    check_renderer,
    draw_caption,
    paint_ink,
    paint_trail,
)
from fmp_drake.numeric import Array, check_number
from fmp_drake.primitives.data.files import check_writable, replaced
from fmp_drake.runs import StationRun, WipingRun
from fmp_drake.runs.log import TemporaryArray
from fmp_drake.station.scenario_parts import FORCE_TOLERANCE, CameraConfig
from fmp_drake.systems import InkGrid
from fmp_drake.systems.surface.surface import place

FILM_SIGNALS = ("measured_position", "normal_force", "desired_normal_force")
"""Names of the signals that a run must keep for its film."""

MAX_FPS = {".mp4": 120.0, ".gif": 50.0}
"""Greatest numbers of frames per second, by the ending of a film's name."""
# A picture of a .gif lasts up to 655 s. In slow motion a step of 1 ms has many frames.
_LEAST_FPS, _LEAST_SPEED = 0.01, 0.001
_SUPERSAMPLING = 2  # Rendered pixels per pixel of a picture, along each edge.
# Duration of the path behind the eraser, and between two of its points, s.
_TRAIL_SECONDS, _TRAIL_STEP = 4.0, 0.02


class FilmReel:
    """Recording of the plant's positions and the ink at the times of a film's frames.

    Call ``simulator.set_monitor(reel.observe)`` before the simulation starts. A simulation
    that is initialised again starts a new recording. Positions stay in memory; the ink, a
    byte per cell, is stored in a temporary file.

    Parameters
    ----------
    station : Diagram
        With a subsystem plant, and an output port ink if there is a board.
    fps : float
        Frames per second of the film.
    speed : float
        Simulated seconds per second of the film.

    Examples
    --------
    >>> from fmp_drake.skills import scenario_skill
    >>> from fmp_drake.station import LoadScenario, MakeWipingStation
    >>> from pydrake.systems.analysis import Simulator
    >>> scenario = LoadScenario("table_top")
    >>> skill, _, _ = scenario_skill(scenario)
    >>> station = MakeWipingStation(scenario, skill)
    >>> reel, simulator = FilmReel(station, fps=20.0), Simulator(station)
    >>> simulator.set_monitor(reel.observe)
    >>> _ = simulator.AdvanceTo(0.1)
    >>> reel.times
    array([0.  , 0.05, 0.1 ])
    """

    def __init__(self, station: Diagram, *, fps: float, speed: float = 1.0) -> None:
        _check_rates(fps, speed)
        self.fps = float(fps)
        self.speed = float(speed)
        self.station = station
        self._plant: Any = station.GetSubsystemByName("plant")
        self._ink: Any = None
        if station.HasOutputPort("ink"):
            self._ink = station.GetOutputPort("ink")
        self._clear()

    def _clear(self) -> None:
        self._times: list[float] = []
        self._positions: list[Array] = []
        cells = 0 if self._ink is None else self._ink.size()
        self._inks = TemporaryArray((cells,), np.uint8)

    def observe(self, root: Context) -> None:
        """Record a frame from a root Context when the next frame is due.

        It is the monitor of a simulator of the station or its diagram.
        """
        time = root.get_time()
        if self._times and time < self._times[-1]:
            self._clear()
        start = self._times[0] if self._times else time
        # In slow motion several frames may show the same step.
        while time >= start + len(self._times) * self.speed / self.fps - 1e-9:
            self._append(time, root)

    def _append(self, time: float, root: Context) -> None:
        """Append a frame of a root Context."""
        self._times.append(time)
        self._positions.append(
            np.array(self._plant.GetPositions(self._plant.GetMyContextFromRoot(root)))
        )
        if self._ink is not None:
            ink = self._ink.Eval(self.station.GetMyContextFromRoot(root))
            self._inks.append(np.rint(255 * np.clip(ink, 0, 1)).astype(np.uint8))

    @property
    def times(self) -> Array:
        """Times of the frames, shape (N,), s."""
        return np.array(self._times)

    @property
    def positions(self) -> Array:
        """Positions of the plant, shape (N, nq)."""
        return np.array(self._positions)

    @property
    def ink(self) -> NDArray[np.uint8]:
        """Remaining ink in each cell, 0 for none to 255 for all, shape (N, ny nx).

        Without a board it has no columns.
        """
        if self._ink is None:
            return np.zeros((len(self._times), 0), np.uint8)
        return self._inks.array()


def _check_rates(fps: float, speed: float) -> None:
    check_number(fps, "fps", least=_LEAST_FPS, error=RunError)
    check_number(speed, "speed", least=_LEAST_SPEED, error=RunError)


def check_film(
    path: Path | None,
    *,
    fps: float = 30.0,
    speed: float = 1.0,
    size: tuple[int, int] = (640, 480),
) -> None:
    """Check that a film can be made, before any work is done.

    Parameters
    ----------
    path : pathlib.Path, optional
        Its suffix determines the format. Nothing is checked if None.
    fps : float
        Frames per second: at most 120, or 50 in a .gif.
    speed : float
        Simulated seconds per second of the film.
    size : tuple of int
        Width and height, pixels; even, because most players need it.

    Raises
    ------
    RunError
        If a value is not allowed, or the packages for films or EGL are missing.
    """
    if path is None:
        return
    check_writable(path, "a film", [*MAX_FPS], RunError)
    suffix = path.suffix.lower()
    check_number(fps, "fps", most=MAX_FPS[suffix], error=RunError)
    _check_rates(fps, speed)
    if any(edge < 16 or edge > 4096 or edge % 2 for edge in size):
        raise RunError(
            f"a film of {size[0]} x {size[1]} pixels: both must be even, and from 16 "
            "to 4096."
        )
    if suffix == ".mp4":
        ffmpeg_program()
    check_renderer()


def film_run(
    run: StationRun,
    reel: FilmReel,
    path: Path,
    *,
    width: int,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Render the film of a run, seen by the camera of its scenario.

    Captions contain the time and, at a board, the normal force with its desired range and
    the clean fraction of the demonstrated area. The path of the last 4 s is drawn behind
    the eraser.

    Parameters
    ----------
    run : StationRun
        Its kept signals include `FILM_SIGNALS`.
    reel : FilmReel
        Recorded during the run.
    path : pathlib.Path
        Ends in .mp4 or .gif.
    width : int
        Pixels; the aspect ratio is 4 to 3.
    track : callable
        Iterates over the numbers of the frames, and may show the progress.

    Raises
    ------
    RunError
        If the film cannot be made; an existing file then remains unchanged.
    """
    times, measured = run.log_times("measured_position"), run.log("measured_position")

    def trail(now: float) -> Array:
        moments = np.arange(max(now - _TRAIL_SECONDS, times[0]), now, _TRAIL_STEP)
        columns = [np.interp(moments, times, column) for column in measured.T]
        return np.stack(columns, axis=1)

    render_film(
        path,
        reel,
        camera=run.scenario.camera,
        size=film_size(width),
        grid=run.grid if isinstance(run, WipingRun) else None,
        captions=_captions(run, reel),
        trail=trail,
        track=track,
    )


def _captions(run: StationRun, reel: FilmReel) -> list[str]:
    """Return the text of each frame."""
    speed = f", {reel.speed:g} times as fast" if reel.speed != 1 else ""
    digits = 0 if reel.speed >= 1 else 1
    texts = [f"{time:.{digits}f} s{speed}" for time in reel.times]
    if not isinstance(run, WipingRun):
        return texts
    times, values = run.log_times("normal_force"), run.log("normal_force")[:, 0]
    forces = np.interp(reel.times, times, values)
    desired = np.interp(reel.times, times, run.desired_force())
    ranges = [
        f"{max(0.0, force - FORCE_TOLERANCE):.3g} to {force + FORCE_TOLERANCE:.3g} N"
        for force in desired
    ]
    fractions = run.cleaned_by(reel.times)
    cleaned = [
        f"cleaned {100 * fraction:.{int(fraction >= 0.995)}f} % of the demonstrated area"
        for fraction in fractions
    ]
    if fractions[0] == 1:
        cleaned = ["the demonstrated paths touch no ink"] * len(texts)
    return [
        f"{text}\nforce {force:.1f} N (desired {allowed})\n{last}"
        for text, force, allowed, last in zip(
            texts, forces, ranges, cleaned, strict=True
        )
    ]


def film_size(width: int) -> tuple[int, int]:
    """Return width and height of a film of 4 to 3, pixels; the height is even."""
    return width, 2 * round(width * 3 / 8)


def render_film(
    path: Path,
    reel: FilmReel,
    *,
    camera: CameraConfig,
    size: tuple[int, int],
    grid: InkGrid | None = None,
    captions: Sequence[str] | None = None,
    trail: Callable[[float], Array] | None = None,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> None:
    """Render a film of a station without a screen; an existing file is replaced.

    The plant's positions determine where everything is drawn, a moving board included.

    Parameters
    ----------
    path : pathlib.Path
        Ends in .mp4 or .gif.
    reel : FilmReel
    camera : CameraConfig
    size : tuple of int
        Width and height, pixels; even.
    grid : InkGrid, optional
        None in free space, where there is no ink and the trail is not on a board.
    captions : sequence of str, optional
        Text of each frame.
    trail : callable, optional
        Returns the points p_B (k, 3) of the tool's path at a time, m. On a board their
        projections are drawn.
    track : callable
        Iterates over the numbers of the frames, and may show the progress.

    Raises
    ------
    RunError
        If the film cannot be made; an existing file then remains unchanged.
    """
    path = Path(path)
    check_film(path, fps=reel.fps, size=size)
    scene = FilmScene(reel.station, camera, size)
    times, positions, inks = reel.times, reel.positions, reel.ink

    def frame(i: int) -> NDArray[np.uint8]:
        shot = scene.render(positions[i])
        visible = np.ones(shot.depth.shape, dtype=bool)
        if grid is not None:
            visible = paint_ink(shot, grid, inks[i])
        if trail is not None:
            points = trail(times[i])
            if grid is not None:
                points = place(grid.curvature, points * [1.0, 1.0, 0.0])
            paint_trail(shot.color, shot.pixels(points), where=visible)
        picture = Image.fromarray(shot.color)
        if captions is not None:
            draw_caption(picture, captions[i])
        return np.asarray(picture)

    write_film(path, frame, len(times), fps=reel.fps, track=track)


def render_picture(
    path: Path,
    reel: FilmReel,
    *,
    camera: CameraConfig,
    size: tuple[int, int],
    grid: InkGrid | None = None,
) -> None:
    """Render the last frame of a reel without a screen; an existing file is replaced.

    Parameters
    ----------
    path : pathlib.Path
        In any format that Pillow writes.
    reel, camera, size, grid
        As for `render_film`.

    Raises
    ------
    RunError
        If EGL does not work.
    """
    check_renderer()
    rendered_size = (size[0] * _SUPERSAMPLING, size[1] * _SUPERSAMPLING)
    shot = FilmScene(reel.station, camera, rendered_size).render(reel.positions[-1])
    if grid is not None:
        paint_ink(shot, grid, reel.ink[-1])
    with replaced(path, RunError) as part:
        Image.fromarray(shot.color).reduce(_SUPERSAMPLING).save(part)
