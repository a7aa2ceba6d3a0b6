"""Fourier movement primitives (FMP) for Drake.

The packages, each importing only from those before it:

- `fmp_drake.primitives` learns and plays rhythmic skills (NumPy, SciPy,
  scikit-learn; no Drake);
- `fmp_drake.systems` wraps them as Drake systems;
- `fmp_drake.station` wires robot, task and controller by a scenario;
- `fmp_drake.skills` finds, learns and places the skill of a scenario;
- `fmp_drake.runs`, `fmp_drake.plots` and `fmp_drake.film` measure, draw and film
  its runs;
- `fmp_drake.experiments` repeats the paper's section V, compares methods and runs
  randomised scenarios;
- `fmp_drake.apps` is the command line.

The method is Kulak, Silvério and Calinon, "Fourier movement primitives: an
approach for learning rhythmic robot skills from demonstrations", RSS 2020.
"""

from typing import TYPE_CHECKING, Any

from fmp_drake.errors import (
    DemonstrationError,
    ExperimentError,
    FmpError,
    RunError,
    SkillError,
    SkillFileError,
    StationError,
    SystemsError,
)

if TYPE_CHECKING:
    from fmp_drake.primitives import (
        Demonstration,
        FourierMovementPrimitive,
        Player,
        load_skill,
        save_skill,
    )

__version__ = "0.2.0"

__all__ = [
    "Demonstration",
    "DemonstrationError",
    "ExperimentError",
    "FmpError",
    "FourierMovementPrimitive",
    "Player",
    "RunError",
    "SkillError",
    "SkillFileError",
    "StationError",
    "SystemsError",
    "__version__",
    "load_skill",
    "save_skill",
]


def __getattr__(name: str) -> Any:
    """Import the skill layer at the first use of one of its names."""
    if name in __all__:
        from fmp_drake import primitives

        return getattr(primitives, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, including those not imported yet."""
    return sorted({*globals(), *__all__})
