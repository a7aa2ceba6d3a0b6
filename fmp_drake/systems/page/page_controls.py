"""Sliders of the page."""

from math import isfinite
from typing import NamedTuple, Self

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number


class _Slider(NamedTuple):
    """Range, step, and greatest rate of change of the output (per second) of a slider."""

    label: str
    low: float
    high: float
    step: float
    rate: float

    def reaching(self, value: float) -> Self:
        """Return the slider with its range extended to a value."""
        return self._replace(low=min(self.low, value), high=max(self.high, value))


_SLIDERS = {
    "tempo": _Slider("tempo", 0.25, 2.0, 0.05, 2.0),
    "press_force": _Slider("press force (N)", 0.0, 15.0, 0.5, 40.0),
    "sample": _Slider("sample", 0.0, 1.0, 1.0, np.inf),
}
# Time between two readings, s.
_PERIOD = 0.128
# Largest difference, in steps, of a slider from the value that it represents.
_ROUNDING = 0.501


def set_tempo(meshcat: Meshcat, tempo: float) -> None:
    """Move the slider of the tempo, as a user of the page would."""
    meshcat.SetSliderValue(_SLIDERS["tempo"].label, tempo)


class PageControls(LeafSystem):
    """Sliders for the tempo, the normal force and mean or sample, as outputs.

    The page is an external input: it is sampled at a fixed rate, and the sample is the
    state. The initialisation of a simulation adds the sliders and sets them to the values
    in its Context; they remain until `Delete`. A slider rounds its value: until a user
    moves it, its output keeps the exact value.

    A page may send any number. The outputs stay within the ranges of the sliders and change
    by at most 2 per second (tempo) and 40 N per second; NaN and infinity are ignored.

    Output ports
    ------------
    tempo : (1,)
        Relative to the demonstration, 1 for the same.
    press_force : (1,)
        Desired normal force, N.
    sample : (1,)
        1 to track samples of the components, 0 for their means.

    Parameters
    ----------
    meshcat : Meshcat
        Its page gets the sliders.
    tempo : float
        Initial value. The range of the slider is 0.25 to 2, extended to this value.
    press_force : float or None
        Initial value of the desired normal force, N. The range of the slider is 0 to
        15, extended to this value. None for neither slider nor port.
    sample : bool
        Initial value.

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
        press_force: float | None = 10.0,
        sample: bool = False,
    ) -> None:
        super().__init__()
        self.set_name("page_controls")
        self._meshcat = meshcat
        # By the index of their state, with ranges that include the initial values.
        self._sliders: dict[int, _Slider] = {}
        initial = {
            "tempo": tempo,
            "press_force": press_force,
            "sample": float(sample),
        }
        for name, value in initial.items():
            if value is None:
                continue
            check_number(value, name, least=0, error=SystemsError)
            index = self.DeclareDiscreteState(np.array([float(value)]))
            self._sliders[int(index)] = _SLIDERS[name].reaching(value)
            self.DeclareStateOutputPort(name, index)
        self.DeclareInitializationPublishEvent(self._show)
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, self._read)

    def Delete(self) -> None:
        """Remove the sliders from the page; the outputs keep their values."""
        for slider in _SLIDERS.values():
            self._meshcat.DeleteSlider(slider.label, strict=False)

    def _show(self, context: Context) -> None:
        sliders = self._meshcat.GetSliderNames()
        for index, slider in self._sliders.items():
            value = self._value(context, index)
            label, low, high, step, _ = slider.reaching(value)
            if label in sliders:
                shown_value = self._meshcat.SetSliderValue(label, value)
                if abs(shown_value - value) <= _ROUNDING * step:
                    continue
                # Another simulation's slider ends before this value.
                self._meshcat.DeleteSlider(label)
            self._meshcat.AddSlider(label, low, high, step, value)

    def _value(self, context: Context, index: int) -> float:
        return float(context.get_discrete_state(index).value()[0])

    def _read(self, context: Context, values: DiscreteValues) -> None:
        sliders = self._meshcat.GetSliderNames()
        for index, (label, low, high, step, rate) in self._sliders.items():
            if label not in sliders:
                continue
            slider_value = self._meshcat.GetSliderValue(label)
            value = self._value(context, index)
            if isfinite(slider_value) and abs(slider_value - value) > _ROUNDING * step:
                change = rate * _PERIOD
                bounded = np.clip(slider_value, low, high)
                values.set_value(
                    index, np.array([np.clip(bounded, value - change, value + change)])
                )
