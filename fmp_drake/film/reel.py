"""Recording of a simulation's positions and ink for a film."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.runs.log import Spill


class FilmReel:
    """Recording of the plant's positions and the ink at the times of a film's frames.

    Call `watch` before the simulation starts. A simulation that is initialised again
    starts a new recording. Positions stay in memory; the ink, a byte per cell, is stored
    in a temporary file.

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
    >>> reel.watch(simulator)
    >>> _ = simulator.AdvanceTo(0.1)
    >>> reel.times
    array([0.  , 0.05, 0.1 ])
    """

    def __init__(self, station: Diagram, *, fps: float, speed: float = 1.0) -> None:
        for name, value in (("fps", fps), ("speed", speed)):
            check_number(value, name, above=0.0, error=RunError)
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
        self._positions: list[NDArray[np.float64]] = []
        cells = 0 if self._ink is None else self._ink.size()
        self._inks = Spill((cells,), np.uint8)

    def watch(self, simulator: Simulator) -> None:
        """Make `observe` the monitor of a simulator of the station or its diagram."""
        simulator.set_monitor(self.observe)

    def observe(self, root: Context) -> None:
        """Record a frame from a root Context when the next frame is due."""
        time = root.get_time()
        if self._times and time < self._times[-1]:
            self._clear()
        start = self._times[0] if self._times else time
        if time < start + len(self._times) * self.speed / self.fps - 1e-9:
            return
        context = self.station.GetMyContextFromRoot(root)
        self._times.append(time)
        self._positions.append(
            np.array(self._plant.GetPositions(self._plant.GetMyContextFromRoot(root)))
        )
        if self._ink is not None:
            ink = self._ink.Eval(context)
            self._inks.append(np.rint(255 * np.clip(ink, 0, 1)).astype(np.uint8))

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames, shape (N,), s."""
        return np.array(self._times)

    @property
    def positions(self) -> NDArray[np.float64]:
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
