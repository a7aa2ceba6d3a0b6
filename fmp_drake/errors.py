"""The errors that fmp_drake raises on bad input."""


class FmpError(Exception):
    """Base of every error that this package raises on purpose."""


class DemonstrationError(FmpError, ValueError):
    """A demonstration that cannot be used: shape, values, timing or length."""


class SkillError(FmpError, ValueError):
    """A request that a skill cannot meet: bad parameters, times or targets."""


class SkillFileError(FmpError, ValueError):
    """A skill or demonstration file that cannot be read."""


class SystemsError(FmpError, ValueError):
    """A value that a Drake system of this package cannot be built from."""


class StationError(FmpError, ValueError):
    """A scenario, a model or a start that the station cannot realise."""


class RunError(FmpError, ValueError):
    """A run, or a log, a picture or a film of one, that cannot be made or read."""


class ExperimentError(FmpError, ValueError):
    """A comparison of methods that cannot be made."""
