"""Facts about the sliders of the page, without a browser."""

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import SystemsError
from fmp_drake.systems.page.page_controls import PageControls

NAMES = {
    "tempo": "tempo",
    "press_force": "press force (N)",
    "sample": "sample",
}


@pytest.fixture
def meshcat():
    return Meshcat()


def outputs(system, simulator):
    context = simulator.get_context()
    return {name: system.GetOutputPort(name).Eval(context)[0] for name in NAMES}


def test_ports_have_names_and_sizes(meshcat):
    controls = PageControls(meshcat)
    assert controls.get_name() == "page_controls"
    assert controls.num_input_ports() == 0
    ports = [controls.get_output_port(i) for i in range(3)]
    assert {port.get_name(): port.size() for port in ports} == dict.fromkeys(NAMES, 1)


def test_the_sliders_come_with_the_initialisation_and_go_with_delete(meshcat):
    controls = PageControls(meshcat)
    assert meshcat.GetSliderNames() == []
    simulator = Simulator(controls)
    simulator.Initialize()
    assert set(meshcat.GetSliderNames()) == set(NAMES.values())
    simulator.Initialize()
    for _ in range(2):
        controls.Delete()
        assert meshcat.GetSliderNames() == []
    simulator.AdvanceTo(1.0)
    assert outputs(controls, simulator)["tempo"] == 1.0


def test_a_moved_slider_is_followed_at_a_bounded_rate(meshcat):
    controls = PageControls(meshcat, tempo=0.8, press_force=9.0, sample=True)
    simulator = Simulator(controls)
    simulator.AdvanceTo(0.3)
    initial = {"tempo": 0.8, "press_force": 9.0, "sample": 1.0}
    assert outputs(controls, simulator) == initial
    moved = {"tempo": 1.5, "press_force": 3.0, "sample": 0.0}
    for name, value in moved.items():
        meshcat.SetSliderValue(NAMES[name], value)
    assert outputs(controls, simulator) == initial
    simulator.AdvanceTo(0.41)
    first = outputs(controls, simulator)
    # By the greatest rates: 2 per second and 40 N per second.
    assert first["tempo"] == pytest.approx(0.8 + 0.256)
    assert first["press_force"] == pytest.approx(9.0 - 5.12)
    assert first["sample"] == 0.0
    simulator.AdvanceTo(0.8)
    assert outputs(controls, simulator) == moved


class Page:
    """A page that says what Meshcat's own methods would refuse."""

    def __init__(self, **values):
        self.values = values

    def GetSliderNames(self):
        return list(self.values)

    def AddSlider(self, *_):
        pass

    def SetSliderValue(self, _, value):
        return value

    def GetSliderValue(self, label):
        return self.values[label]


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1000.0, 15.0), (-5.0, 0.0), (np.nan, 9.0), (np.inf, 9.0), (1e308, 15.0)],
)
def test_no_page_moves_an_output_out_of_its_range(value, expected):
    controls = PageControls(Page(**{"press force (N)": value}), press_force=9.0)
    simulator = Simulator(controls)
    simulator.AdvanceTo(2.0)
    assert outputs(controls, simulator)["press_force"] == expected


def test_an_untouched_slider_does_not_round_the_initial_value(meshcat):
    initial = {"tempo": 0.83, "press_force": 9.123, "sample": 0.0}
    controls = PageControls(meshcat, tempo=0.83, press_force=9.123)
    simulator = Simulator(controls)
    simulator.AdvanceTo(0.5)
    assert outputs(controls, simulator) == initial
    meshcat.SetSliderValue("tempo", 0.9)
    simulator.AdvanceTo(0.7)
    assert outputs(controls, simulator)["tempo"] == pytest.approx(0.9)


def test_a_slider_reaches_an_unusual_initial_value(meshcat):
    controls = PageControls(meshcat, tempo=3.0, press_force=22.0)
    simulator = Simulator(controls)
    simulator.AdvanceTo(0.5)
    assert meshcat.GetSliderValue("tempo") == 3.0
    assert outputs(controls, simulator)["press_force"] == 22.0


def test_an_initialisation_shows_the_values_of_its_context(meshcat):
    controls = PageControls(meshcat, tempo=0.83)
    simulator = Simulator(controls)
    simulator.AdvanceTo(0.1)
    meshcat.SetSliderValue("tempo", 2.0)
    simulator.AdvanceTo(0.8)
    fresh = Simulator(controls)
    fresh.AdvanceTo(0.3)
    assert meshcat.GetSliderValue("tempo") == pytest.approx(0.85)
    assert outputs(controls, fresh)["tempo"] == 0.83
    simulator.Initialize()
    assert meshcat.GetSliderValue("tempo") == 2.0
    simulator.AdvanceTo(1.0)
    assert outputs(controls, simulator)["tempo"] == 2.0


def test_a_continued_run_keeps_the_exact_values(meshcat):
    controls = PageControls(meshcat, tempo=0.83, press_force=31.7)
    simulator = Simulator(controls)
    simulator.AdvanceTo(0.25)
    # In between, another simulation has used the page.
    Simulator(PageControls(meshcat)).Initialize()
    controls.Delete()
    Simulator(PageControls(meshcat)).Initialize()
    copy = Simulator(controls, simulator.get_context().Clone())
    copy.AdvanceTo(1.0)
    expected = {"tempo": 0.83, "press_force": 31.7, "sample": 0.0}
    assert outputs(controls, copy) == expected


def test_two_pages_do_not_disturb_each_other():
    pages = [Meshcat(), Meshcat()]
    stations = [PageControls(page) for page in pages]
    simulators = [Simulator(station) for station in stations]
    for simulator in simulators:
        simulator.AdvanceTo(0.1)
    pages[0].SetSliderValue("tempo", 2.0)
    for simulator in simulators:
        simulator.AdvanceTo(1.0)
    tempos = [
        outputs(*pair)["tempo"] for pair in zip(stations, simulators, strict=True)
    ]
    assert tempos == [2.0, 1.0]
    stations[0].Delete()
    assert len(pages[1].GetSliderNames()) == 3


@pytest.mark.parametrize("options", [{"tempo": -1.0}, {"press_force": np.nan}])
def test_values_that_do_not_fit_are_refused(meshcat, options):
    with pytest.raises(SystemsError, match="must"):
        PageControls(meshcat, **options)
