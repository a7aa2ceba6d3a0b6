"""Facts about what the panel says of a station."""

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.systems import StatusFlag
from fmp_drake.systems.page.page_panel import PagePanel
from fmp_drake.systems.page.page_status import PageStatus, mode_in_words

STOP = StatusFlag.PROTECTIVE_STOP
INPUTS = {
    "status": [0.0] * 6,
    "last_fault": [0.0],
    "normal_force": [9.0],
    "desired_normal_force": [9.0],
    "ink": [0.0, 1.0, 0.05, 1.0],
    "component": [3.0],
}


@pytest.fixture
def panel():
    panel = PagePanel(Meshcat())
    yield panel
    panel.close()


def make_simulator(panel, forgotten=None, area=(True, True, True, False), **inputs):
    builder = DiagramBuilder()
    shown = builder.AddSystem(PageStatus(panel, area=area))
    for name, value in {**INPUTS, **inputs}.items():
        if name != forgotten:
            source = builder.AddSystem(ConstantVectorSource(np.array(value)))
            builder.Connect(source.get_output_port(), shown.GetInputPort(name))
    return Simulator(builder.Build())


def test_ports_have_names_and_sizes(panel):
    status = PageStatus(panel, area=np.ones((2, 3)))
    ports = [status.get_input_port(i) for i in range(status.num_input_ports())]
    sizes = {"status": 6, "ink": 6}
    sizes |= dict.fromkeys(set(INPUTS) - set(sizes), 1)
    assert {port.get_name(): port.size() for port in ports} == sizes
    assert status.num_output_ports() == 0


def test_panel_shows_time_force_component_and_cleaned_fraction(panel):
    make_simulator(panel).AdvanceTo(0.03)
    shown = panel.shown
    assert (shown["time"], shown["force"], shown["mode"]) == (0.0, 9.0, "wiping")
    assert shown["cleaned"] == pytest.approx(2 / 3)
    assert shown["component"] == "mean of component 3"


def test_an_area_without_cells_has_no_cleaned_fraction(panel):
    make_simulator(panel, area=[False] * 4).AdvanceTo(0.03)
    assert "cleaned" not in panel.shown


@pytest.mark.parametrize(
    ("flag", "level", "mode"),
    [(STOP, "bad", "protective stop"), (StatusFlag.RECOVER, "busy", "going back")],
)
def test_the_reason_of_a_stop_is_shown_during_it_and_after(panel, flag, level, mode):
    status, fault = [float(flag), 0, 0, 0, 0, 0], [float(StatusFlag.NOT_FOUND)]
    make_simulator(panel, status=status, last_fault=fault).AdvanceTo(0.03)
    assert (panel.shown["level"], panel.shown["mode"]) == (level, mode)
    assert "no board was found within the search range" in panel.shown["detail"]


@pytest.mark.parametrize(
    ("flags", "force", "mode"),
    [
        (0, 9.0, "wiping"),
        (0, 0.0, "in the air"),
        (
            StatusFlag.FORCE_CONTROL | StatusFlag.CONTACT_LOST,
            0.0,
            "searching for the board",
        ),
        (StatusFlag.RECOVER, 9.0, "going back"),
        (STOP | StatusFlag.CONTACT_LOST, 0.0, "protective stop"),
        (StatusFlag.BELOW_SURFACE, 9.0, "below the board"),
        (StatusFlag.ARM_TOUCHES, 9.0, "arm on the board"),
        (StatusFlag.TORQUE_LIMITED, 9.0, "wiping"),
    ],
)
def test_every_mode_has_a_text(flags, force, mode):
    assert mode_in_words(flags, 0, force, desired=9.0)[1] == mode


@pytest.mark.parametrize("force", [0.0, 2.0])
def test_an_arm_without_a_normal_force_asks_for_one(force):
    level, mode, detail = mode_in_words(0, 0, force, desired=0.0)
    assert (level, mode) == ("busy", "no press force")
    assert detail == "set one, so that the eraser wipes"
    stopped = mode_in_words(STOP, 0, force, desired=0.0)
    assert stopped[1] == "protective stop"


@pytest.mark.parametrize("forgotten", INPUTS)
def test_a_forgotten_input_is_named(panel, forgotten):
    with pytest.raises(
        (RuntimeError, ValueError), match=rf"\({forgotten}\).*page_status"
    ):
        make_simulator(panel, forgotten).AdvanceTo(0.1)
