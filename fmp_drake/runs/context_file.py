"""Saved Contexts: everything a simulation needs to go on in another process.

The file is an `.npz` without pickle: the time, the continuous state, and each group of
discrete state and of numeric parameters as an array of its own.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Context

from fmp_drake.errors import RunError
from fmp_drake.primitives.data.file_format import FileFormat

FORMAT = FileFormat(
    name="fmp-drake-context",
    version=1,
    what="saved Context",
    source="written by `save_context`",
    error=RunError,
)


def save_context(context: Context, path: str | Path) -> None:
    """Write time, state and numeric parameters of a Context to a file.

    What is no state is not saved: abstract parameters, values that input ports were
    fixed to, and caches.

    Parameters
    ----------
    context : Context
        Of a diagram without abstract state.
    path : path
        Ends in .npz; an existing file is replaced at the end.

    Raises
    ------
    RunError
        Where the diagram has abstract state, or the file cannot be written.
    """
    if context.num_abstract_states():
        raise RunError(
            "a Context is saved as numbers, but there is abstract state in "
            f"{', '.join(_systems_with_abstract_state(context))}."
        )
    arrays = {name: vector.CopyToVector() for name, vector in _vectors(context)}
    FORMAT.write(Path(path), {"time": context.get_time()}, arrays)


def load_context(context: Context, path: str | Path) -> None:
    """Set a Context to what `save_context` has written.

    The systems of this package go on from it in a new Simulator. Others may act on
    initialization: ``InitializeParams(suppress_initialization_events=True)``. The step
    size of an integrator with error control belongs to the Simulator, and is not saved.

    Parameters
    ----------
    context : Context
        Of a diagram that was built as the saved one was; unchanged after an error.
    path : path

    Raises
    ------
    RunError
        Where the file is missing, broken, newer, or of another diagram.
    """
    metadata, arrays = FORMAT.read(Path(path))
    given = {name: values.shape for name, values in arrays.items()}
    expected = {name: (vector.size(),) for name, vector in _vectors(context)}
    for name in sorted(given.keys() | expected.keys()):
        if given.get(name) != expected.get(name):
            raise RunError(
                f"{path} is of another diagram: its {name.replace('_', ' ')} has shape "
                f"{given.get(name, 'none')}, this Context's {expected.get(name, 'none')}."
            )
    time = metadata.get("time")
    if not isinstance(time, float) or any(v.dtype != float for v in arrays.values()):
        raise RunError(f"{path} is an incomplete Context: it holds no numbers.")
    context.SetTime(time)
    for name, vector in _vectors(context, mutable=True):
        vector.SetFromVector(arrays[name])


def _vectors(context: Any, *, mutable: bool = False) -> Iterator[tuple[str, Any]]:
    """Yield the name and the vector of all state and parameters that are numbers."""
    get = "get_mutable" if mutable else "get"
    yield "continuous_state", getattr(context, f"{get}_continuous_state_vector")()
    for i in range(context.num_discrete_state_groups()):
        state = getattr(context, f"{get}_discrete_state")
        yield f"discrete_state_{i}", state(i)
    for i in range(context.num_numeric_parameter_groups()):
        yield f"parameter_{i}", getattr(context, f"{get}_numeric_parameter")(i)


def _systems_with_abstract_state(context: Context) -> list[str]:
    """Return the path names of systems, which only a Context's text tells."""
    blocks = re.split(r"^(::\S.*) Context\b.*\n-+$", str(context), flags=re.MULTILINE)
    return [
        name.removeprefix("::_::")
        for name, text in zip(blocks[1::2], blocks[2::2], strict=True)
        if re.search(r"^ +\d+ abstract states", text, re.MULTILINE)
    ]
