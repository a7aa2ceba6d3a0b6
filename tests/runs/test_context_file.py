"""Facts about saved Contexts."""

import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import (
    InitializeParams,
    ResetIntegratorFromFlags,
    Simulator,
)
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    AffineSystem,
    ConstantVectorSource,
    ZeroOrderHold,
)

from fmp_drake.errors import RunError
from fmp_drake.runs import load_context, save_context


class Remembers(LeafSystem):
    """Has abstract state."""

    def __init__(self):
        super().__init__()
        self.set_name("remembers")
        self.DeclareAbstractState(Value({"a": 1}))


def make(extra=()):
    """Return a diagram with continuous and discrete state and parameters."""
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(np.array([0.3])))
    swing = builder.AddSystem(
        AffineSystem(
            A=np.array([[0.0, 1.0], [-2.0, -0.1]]),
            B=np.array([[0.0], [1.0]]),
            C=np.eye(2),
        )
    )
    walk = builder.AddSystem(
        AffineSystem(A=np.array([[0.7]]), B=np.array([[1.0]]), time_period=0.01)
    )
    hold = builder.AddSystem(ZeroOrderHold(0.1, 2))
    builder.Connect(source.get_output_port(), swing.get_input_port())
    builder.Connect(source.get_output_port(), walk.get_input_port())
    builder.Connect(swing.get_output_port(), hold.get_input_port())
    for system in extra:
        builder.AddSystem(system)
    inner = builder.Build()
    outer = DiagramBuilder()
    outer.AddSystem(inner)
    return outer.Build()


def numbers(context):
    groups = [
        context.get_discrete_state(i).value()
        for i in range(context.num_discrete_state_groups())
    ]
    continuous = context.get_continuous_state_vector().CopyToVector()
    return np.concatenate([[context.get_time()], continuous, *groups])


def simulated(context, diagram, until):
    simulator = Simulator(diagram, context)
    ResetIntegratorFromFlags(simulator, "runge_kutta2", 0.01)
    simulator.Initialize(InitializeParams(suppress_initialization_events=True))
    simulator.AdvanceTo(until)
    return numbers(simulator.get_context())


@pytest.fixture
def saved(tmp_path):
    """A file of a Context at 0.733 s, with a parameter that was changed, and it."""
    diagram = make()
    context = diagram.CreateDefaultContext()
    context.get_mutable_numeric_parameter(0).SetFromVector([0.7])
    simulator = Simulator(diagram, context)
    ResetIntegratorFromFlags(simulator, "runge_kutta2", 0.01)
    simulator.AdvanceTo(0.733)
    save_context(simulator.get_context(), tmp_path / "state.npz")
    return tmp_path / "state.npz", simulator


def test_loaded_context_continues_as_the_original(saved):
    path, simulator = saved
    again = make()
    context = again.CreateDefaultContext()
    load_context(context, path)
    assert_array_equal(numbers(context), numbers(simulator.get_context()))
    later = simulated(context, again, 1.5)
    simulator.AdvanceTo(1.5)
    assert_array_equal(later, numbers(simulator.get_context()))
    assert context.get_numeric_parameter(0).value() == [0.7]


def test_systems_with_abstract_state_are_named(tmp_path):
    diagram = make([Remembers()])
    with pytest.raises(RunError, match=r"abstract state in .*::remembers\."):
        save_context(diagram.CreateDefaultContext(), tmp_path / "state.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_plant_that_samples_its_outputs_is_saved_as_the_error_advises(tmp_path):
    plant = MultibodyPlant(0.001)
    plant.Finalize()
    with pytest.raises(RunError, match=r"SetUseSampledOutputPorts\(False\)"):
        save_context(plant.CreateDefaultContext(), tmp_path / "state.npz")
    plant = MultibodyPlant(0.001)
    plant.SetUseSampledOutputPorts(False)
    plant.Finalize()
    save_context(plant.CreateDefaultContext(), tmp_path / "state.npz")
    assert (tmp_path / "state.npz").exists()


def test_the_context_of_another_diagram_is_refused_and_unchanged(saved):
    path, _ = saved
    for extra in ([ZeroOrderHold(0.1, 3)], [ConstantVectorSource(np.ones(2))]):
        context = make(extra).CreateDefaultContext()
        before = numbers(context)
        with pytest.raises(RunError, match=r"of another diagram: its .* has shape"):
            load_context(context, path)
        assert_array_equal(numbers(context), before)


def test_missing_foreign_broken_and_newer_files_are_refused(saved, tmp_path):
    path, _ = saved
    context = make().CreateDefaultContext()
    with pytest.raises(RunError, match="there is no saved Context"):
        load_context(context, tmp_path / "nowhere.npz")
    half = tmp_path / "half.npz"
    half.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(RunError, match="not a readable"):
        load_context(context, half)
    np.savez(half, x=np.zeros(3))
    with pytest.raises(RunError, match="is not a saved Context"):
        load_context(context, half)
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["metadata"]))
    for change, match in (({"version": 2}, "version 2"), ({"time": "x"}, "incomplete")):
        metadata = np.array(json.dumps({**about, **change}))
        np.savez(half, **{**arrays, "metadata": metadata})
        with pytest.raises(RunError, match=match):
            load_context(context, half)
    np.savez(half, **{**arrays, "discrete_state_0": np.array(["x"])})
    with pytest.raises(RunError, match="incomplete"):
        load_context(context, half)
