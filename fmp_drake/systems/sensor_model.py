"""Model of an arm's sensors: delay, noise and sampling rate."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, check_number, finite_array, read_only

# Samples whose noise is drawn at once.
_BLOCK = 1000


class SensorModel(LeafSystem):
    """Sensors that sample an arm's state at a rate, with noise and a delay.

    Input port ``state`` (2n): the arm's ``[q, v]``, rad and rad/s. Output port
    ``measured_state`` (2n): the delayed sample; it is discrete state.

    Parameters
    ----------
    initial : array_like, shape (2n,)
        Output before the first sample arrives.
    rate : float
        Samples per second.
    delay : float
        Age of a sample when it arrives, s; rounded to whole samples.
    position_noise, velocity_noise : float
        Standard deviations, rad and rad/s.
    seed : int
        Of the noise; the noise depends on the seed and the number of the sample only.

    Raises
    ------
    SystemsError
        If a value is out of range, or the initial state is not one.

    Examples
    --------
    One joint, whose state arrives 2 ms late:

    >>> from pydrake.systems.analysis import Simulator
    >>> sensors = SensorModel(initial=[0.0, 0.0], rate=1000.0, delay=0.002)
    >>> simulator = Simulator(sensors)
    >>> context = simulator.get_mutable_context()
    >>> _ = sensors.get_input_port().FixValue(context, [0.3, 0.1])
    >>> for time in (0.0015, 0.0025):
    ...     _ = simulator.AdvanceTo(time)
    ...     print(sensors.get_output_port().Eval(context))
    [0. 0.]
    [0.3 0.1]
    """

    def __init__(
        self,
        *,
        initial: ArrayLike,
        rate: float,
        delay: float = 0.0,
        position_noise: float = 0.0,
        velocity_noise: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.set_name("sensors")
        check_number(rate, "the sensors' rate", above=0, unit="Hz", error=SystemsError)
        noise = {"position_noise": position_noise, "velocity_noise": velocity_noise}
        for name, value in {"delay": delay, "seed": seed, **noise}.items():
            check_number(value, f"the sensors' {name}", least=0, error=SystemsError)
        what = "the sensors' initial state"
        first = finite_array(initial, what, ("2n",), error=SystemsError)
        n, odd = divmod(len(first), 2)
        if odd:
            raise SystemsError(
                f"{what} has {len(first)} values; positions and velocities are needed."
            )
        self._period = 1 / rate
        self._delay = round(delay * rate)  # Samples.
        self._seed = int(seed)
        self._is_noisy = position_noise > 0 or velocity_noise > 0
        self._deviation = np.repeat([position_noise, velocity_noise], n)
        self._state = self.DeclareVectorInputPort("state", 2 * n)
        delivered = self.DeclareDiscreteState(first)
        # Samples that have not arrived, the newest first.
        self.DeclareDiscreteState(np.tile(first, max(self._delay, 1)))
        self.DeclareStateOutputPort("measured_state", delivered)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        measured = np.array(self._state.Eval(context))
        if self._is_noisy:
            block, row = divmod(round(context.get_time() / self._period), _BLOCK)
            measured += self._deviation * _noise(self._seed, block, measured.size)[row]
        if self._delay == 0:
            values.set_value(0, measured)
            return
        queue = context.get_discrete_state().value(1)
        values.set_value(0, queue[-measured.size :])
        values.set_value(1, np.concatenate([measured, queue[: -measured.size]]))


@lru_cache(maxsize=8)
def _noise(seed: int, block: int, size: int) -> Array:
    """Return the noise of a block of samples with deviation 1, shape (_BLOCK, size)."""
    noise = np.random.default_rng([seed, block])
    return read_only(noise.standard_normal((_BLOCK, size)))
