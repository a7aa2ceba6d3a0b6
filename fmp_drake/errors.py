"""Errors that fmp_drake raises for invalid input."""


class FmpError(Exception):
    """Base of all errors that this package raises for invalid input."""


class DemonstrationError(FmpError, ValueError):
    """A demonstration that cannot be used: shape, values, timing or length."""


class SkillError(FmpError, ValueError):
    """A request that a skill cannot meet: bad parameters, times or targets."""


class NoPhaseError(SkillError, AttributeError):
    """A property of the cycle of a skill without a phase model: it has no such attribute."""


class SkillFileError(FmpError, ValueError):
    """A skill or demonstration file that cannot be read."""


class SystemsError(FmpError, ValueError):
    """A value for which a Drake system of this package cannot be built."""


class StationError(FmpError, ValueError):
    """A scenario, a model or a start that the station cannot realise."""


class RunError(FmpError, ValueError):
    """A run, or a log, a picture or a film of one, that cannot be made or read."""


class ExperimentError(FmpError, ValueError):
    """A comparison of methods that cannot be made."""
