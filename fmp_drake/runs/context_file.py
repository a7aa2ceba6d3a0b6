"""Files of Contexts, from which another process can continue a simulation.

The file is an `.npz` without pickle. It contains the time, the continuous state, and an
array for each group of discrete state and of numeric parameters.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Context

from fmp_drake.errors import RunError
from fmp_drake.numeric import as_path
from fmp_drake.primitives.data.files import FileFormat

FORMAT = FileFormat(
    name="fmp-drake-context",
    version=1,
    what="saved Context",
    source="written by `save_context`",
    error=RunError,
)


def save_context(context: Context, path: str | Path) -> None:
    """Write time, state and numeric parameters of a Context to a file.

    Abstract parameters, fixed values of input ports and caches are not saved.

    Parameters
    ----------
    context : Context
        Context of a diagram without abstract state. A discrete MultibodyPlant has such state
        unless `SetUseSampledOutputPorts(False)` is called before `Finalize`.
    path : path
        Ends in .npz. An existing file is replaced at the end.

    Raises
    ------
    RunError
        If the diagram has abstract state, or the file cannot be written.
    """
    if context.num_abstract_states():
        raise RunError(
            "a Context is saved as numbers, but there is abstract state in "
            f"{', '.join(_systems_with_abstract_state(context))}. A discrete MultibodyPlant "
            "has none after SetUseSampledOutputPorts(False), before Finalize()."
        )
    arrays = {name: vector.CopyToVector() for name, vector in _vectors(context)}
    file = as_path(path, error=RunError)
    FORMAT.write(file, {"time": context.get_time()}, arrays)


def load_context(context: Context, path: str | Path) -> None:
    """Restore a Context from a file of `save_context`.

    The systems of this package continue from it in a new Simulator. Other systems may have
    initialization events: ``InitializeParams(suppress_initialization_events=True)``. The
    step size of an integrator with error control belongs to the Simulator and is not saved.

    Parameters
    ----------
    context : Context
        Context of a diagram that is built like the saved one, such as a station of the same
        scenario and skill. Only the sizes of its state and parameters can be compared with
        the file's. An error does not change it.
    path : path

    Raises
    ------
    RunError
        If the file is missing, broken, newer, or of a diagram with other sizes.
    """
    metadata, arrays = FORMAT.read(as_path(path, error=RunError))
    stored = {name: values.shape for name, values in arrays.items()}
    expected = {name: (vector.size(),) for name, vector in _vectors(context)}
    for name in sorted(stored.keys() | expected.keys()):
        if stored.get(name) != expected.get(name):
            raise RunError(
                f"{path} is of another diagram: its {name.replace('_', ' ')} has shape "
                f"{stored.get(name, 'none')}, this Context's {expected.get(name, 'none')}."
            )
    time = metadata.get("time")
    if not isinstance(time, float) or any(v.dtype != float for v in arrays.values()):
        raise RunError(f"{path} is an incomplete Context: it contains no numbers.")
    context.SetTime(time)
    for name, vector in _vectors(context, mutable=True):
        vector.SetFromVector(arrays[name])


def _vectors(context: Any, *, mutable: bool = False) -> Iterator[tuple[str, Any]]:
    """Yield name and vector of all numeric state and parameters."""
    get = "get_mutable" if mutable else "get"
    yield "continuous_state", getattr(context, f"{get}_continuous_state_vector")()
    for i in range(context.num_discrete_state_groups()):
        state = getattr(context, f"{get}_discrete_state")
        yield f"discrete_state_{i}", state(i)
    for i in range(context.num_numeric_parameter_groups()):
        yield f"parameter_{i}", getattr(context, f"{get}_numeric_parameter")(i)


def _systems_with_abstract_state(context: Context) -> list[str]:
    """Return the paths of systems with abstract state, from the Context's text."""
    blocks = re.split(r"^(::\S.*) Context\b.*\n-+$", str(context), flags=re.MULTILINE)
    return [
        name.removeprefix("::_::")
        for name, text in zip(blocks[1::2], blocks[2::2], strict=True)
        if re.search(r"^ +\d+ abstract states", text, re.MULTILINE)
    ]
