"""What a scenario says of the skill."""

from dataclasses import dataclass
from typing import get_args

from fmp_drake.errors import StationError
from fmp_drake.primitives.model.parameters import ModelChoice
from fmp_drake.settings import bounded


@dataclass(kw_only=True)
class SkillConfig:
    """What the robot does.

    Attributes
    ----------
    demonstration : str
        Bundled (eight, polishing, wiping) or a file, relative to the scenario's, to
        learn from.
    file : str
        A learned skill to play instead.
    window, components
        Of the learning: seconds and Gaussians; None for as many as the recordings allow.
    model : str
        What is learned: automatic, phase or mixture, as for `FourierMovementPrimitive`.
    sample : bool
        Whether to track samples of the components or their means.
    candidates : int
        How many samples are drawn at the start and at each re-mapping; the one that
        passes over the most ink of the demonstrated area is tracked. 1 for any sample,
        as in the paper.
    margin : float
        How far samples may leave the demonstrated paths, m.
    seed : int
        Of the samples.
    tempo : float
        1 is as demonstrated.
    push_threshold : float or None
        Distance from the path, m, from which on the movement waits for a pushed
        robot; None for the periodic mode only.
    push_dwell : float
        Seconds until the motion of a pushed robot is mapped.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> scenario = Scenario(skill=SkillConfig(demonstration="eight", tempo=0.8))
    >>> scenario.check()
    """

    demonstration: str = "wiping"
    file: str = ""
    window: float = bounded(6.0, above=0)
    components: int | None = bounded(None, least=1)
    model: str = "automatic"
    sample: bool = True
    candidates: int = bounded(48, least=1)
    margin: float = bounded(0.02, above=0)
    seed: int = bounded(0, least=0)
    tempo: float = bounded(1.0, least=0, most=4)
    push_threshold: float | None = bounded(None, above=0)
    push_dwell: float = bounded(0.2, above=0)

    def check(self) -> None:
        """Check what the ranges do not say."""
        if self.model not in (known := get_args(ModelChoice)):
            raise StationError(
                f"skill.model is {self.model}; choose one of: {', '.join(known)}."
            )
