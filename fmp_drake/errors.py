"""The errors that fmp_drake raises on bad input."""


class FmpError(Exception):
    """Base of every error that this package raises on purpose."""


class DemonstrationError(FmpError, ValueError):
    """A demonstration that cannot be used: shape, values, timing or length."""


class SkillError(FmpError, ValueError):
    """A request that a skill cannot meet: bad parameters, times or targets."""


class SkillFileError(FmpError, ValueError):
    """A skill or demonstration file that cannot be read."""


class StationError(FmpError, ValueError):
    """A scenario, a model or a start that the station cannot realise."""
