"""Facts about late and noisy measurements."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, Sine

from fmp_drake.errors import SystemsError
from fmp_drake.systems.sensor_model import SensorModel

PHASES = np.array([0.0, 0.5, 1.0, 1.5])


def measured(*, until=1.0, **options):
    """Return times, the state and what is measured of it, every 0.1 ms."""
    builder = DiagramBuilder()
    source = builder.AddSystem(Sine(np.ones(4), np.full(4, 3.0), PHASES, True))
    sensors = builder.AddSystem(SensorModel(initial=np.sin(PHASES), **options))
    builder.Connect(source.get_output_port(0), sensors.GetInputPort("state"))
    log = LogVectorOutput(sensors.GetOutputPort("measured_state"), builder, 1e-4)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(until)
    found = log.FindLog(simulator.get_context())
    times = found.sample_times()
    return times, np.sin(3 * times[:, None] + PHASES), found.data().T.copy()


def test_ports_have_names_and_sizes():
    sensors = SensorModel(initial=np.zeros(14), rate=500.0)
    assert sensors.get_name() == "sensors"
    assert sensors.GetInputPort("state").size() == 14
    assert sensors.GetOutputPort("measured_state").size() == 14
    assert not sensors.HasDirectFeedthrough(0, 0)


@pytest.mark.parametrize(("rate", "delay"), [(1000.0, 0.0), (250.0, 0.02), (100, 0.05)])
def test_measurement_is_late_by_delay_and_less_than_two_samples(rate, delay):
    times, state, got = measured(rate=rate, delay=delay)
    late = times > delay + 3 / rate
    for lag in (delay, delay + 2 / rate):
        lagged = np.sin(3 * (times[:, None] - lag) + PHASES)
        assert np.abs(got - lagged)[late].max() < 3 * 2.1 / rate
    middle = np.sin(3 * (times[:, None] - delay - 0.5 / rate) + PHASES)
    assert np.abs(got - middle)[late].max() < 3 * 0.6 / rate
    assert np.abs(got - state)[late].max() > 3 * 0.9 * delay


def test_first_value_stays_until_a_sample_has_arrived():
    times, _, got = measured(rate=100.0, delay=0.1)
    early = times < 0.099
    assert_allclose(got[early], np.tile(np.sin(PHASES), (early.sum(), 1)))


def test_noise_has_its_deviations_and_follows_from_the_seed():
    options = {"rate": 1000.0, "position_noise": 0.01, "velocity_noise": 0.2}
    _, _, one = measured(until=3.0, seed=1, **options)
    _, _, clean = measured(until=3.0, rate=1000.0)
    noise = (one - clean)[10::10]
    assert_allclose(noise.std(axis=0), [0.01, 0.01, 0.2, 0.2], rtol=0.1)
    assert np.abs(noise.mean(axis=0)).max() < 0.02
    assert np.array_equal(measured(until=3.0, seed=1, **options)[2], one)
    assert not np.array_equal(measured(until=3.0, seed=2, **options)[2], one)


@pytest.mark.parametrize(
    "options",
    [
        {"rate": 0.0},
        {"rate": np.nan},
        {"rate": 100.0, "delay": -0.1},
        {"rate": 100.0, "velocity_noise": -1.0},
        {"rate": 100.0, "seed": -1},
        {"rate": 100.0, "initial": [0.0, np.nan]},
        {"rate": 100.0, "initial": [0.0, 0.1, 0.2]},
    ],
)
def test_values_out_of_range_are_refused(options):
    with pytest.raises(SystemsError, match="sensors'"):
        SensorModel(**{"initial": np.zeros(4)} | options)
