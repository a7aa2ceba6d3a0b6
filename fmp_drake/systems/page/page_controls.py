"""The sliders of the page."""

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number

# Output port: name of the slider, smallest value, largest value, step.
_SLIDERS = {
    "tempo": ("tempo", 0.25, 2.0, 0.05),
    "normal_force": ("normal force (N)", 0.0, 15.0, 0.5),
    "sample": ("play samples", 0.0, 1.0, 1.0),
}
# Largest difference, in steps, of a slider from the value that it stands for.
_ROUNDING = 0.501


class PageControls(LeafSystem):
    """Sliders for the tempo, the normal force and mean or sample, as outputs.

    The page is part of the outside world: it is read at a rate, and what was read is
    the state. The sliders come with the initialisation of a simulation, which sets them
    to the values in its Context, and stay until `Delete`. A slider rounds: as long as
    nobody moves it, its output keeps the exact value.

    Output ports
    ------------
    tempo : (1,)
        How fast to play, 1 as demonstrated.
    normal_force : (1,)
        N.
    sample : (1,)
        1 to track samples of the components, 0 for their means.

    Parameters
    ----------
    meshcat : Meshcat
        Its page gets the sliders.
    tempo : float
        Initial value. The slider goes from 0.25 to 2, or as far as this.
    normal_force : float
        Initial value, N. The slider goes from 0 to 15, or as far as this.
    sample : bool
        Initial value.
    period : float
        Between two readings, s.

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> controls = PageControls(Meshcat(), tempo=0.8)
    >>> context = controls.CreateDefaultContext()
    >>> float(controls.GetOutputPort("tempo").Eval(context)[0])
    0.8
    """

    def __init__(
        self,
        meshcat: Meshcat,
        *,
        tempo: float = 1.0,
        normal_force: float = 10.0,
        sample: bool = False,
        period: float = 0.128,
    ) -> None:
        super().__init__()
        self.set_name("page_controls")
        check_number(period, "period", above=0, unit="s", error=SystemsError)
        self._meshcat = meshcat
        self._states: dict[str, int] = {}
        initial = {
            "tempo": tempo,
            "normal_force": normal_force,
            "sample": float(sample),
        }
        for name, value in initial.items():
            check_number(value, name, least=0, error=SystemsError)
            index = self.DeclareDiscreteState(np.array([float(value)]))
            self._states[name] = int(index)
            self.DeclareStateOutputPort(name, index)
        self.DeclareInitializationPublishEvent(self._show)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._read)

    def Delete(self) -> None:
        """Remove the sliders from the page; the outputs keep their values."""
        for slider, *_ in _SLIDERS.values():
            self._meshcat.DeleteSlider(slider, strict=False)

    def _show(self, context: Context) -> None:
        shown = self._meshcat.GetSliderNames()
        for name, (slider, low, high, step) in _SLIDERS.items():
            value = self._value(context, name)
            if slider in shown:
                there = self._meshcat.SetSliderValue(slider, value)
                if abs(there - value) <= _ROUNDING * step:
                    continue
                # Another simulation's slider ends before this value.
                self._meshcat.DeleteSlider(slider)
            ends = min(low, value), max(high, value)
            self._meshcat.AddSlider(slider, *ends, step, value)

    def _value(self, context: Context, name: str) -> float:
        return float(context.get_discrete_state(self._states[name]).value()[0])

    def _read(self, context: Context, values: DiscreteValues) -> None:
        shown = self._meshcat.GetSliderNames()
        for name, index in self._states.items():
            slider, _, _, step = _SLIDERS[name]
            if slider not in shown:
                continue
            value = self._meshcat.GetSliderValue(slider)
            if abs(value - self._value(context, name)) > _ROUNDING * step:
                values.set_value(index, np.array([value]))
