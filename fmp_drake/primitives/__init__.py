"""Learning and playing Fourier movement primitives. No Drake in here."""

from fmp_drake.primitives.basis import FourierBasis
from fmp_drake.primitives.demonstration import Demonstration
from fmp_drake.primitives.keypoint import Keypoint
from fmp_drake.primitives.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.mapping import Mapping, MappingPlan
from fmp_drake.primitives.movement_primitive import FourierMovementPrimitive
from fmp_drake.primitives.playback import PlaybackState, Player
from fmp_drake.primitives.skill_file import load_skill, save_skill
from fmp_drake.primitives.tracking import (
    ExponentialTracker,
    LqrTracker,
    ProportionalTracker,
    Tracker,
)
from fmp_drake.primitives.windows import sliding_windows

__all__ = [
    "Demonstration",
    "ExponentialTracker",
    "FourierBasis",
    "FourierMovementPrimitive",
    "Keypoint",
    "LowRankGaussian",
    "LqrTracker",
    "Mapping",
    "MappingPlan",
    "PlaybackState",
    "Player",
    "ProportionalTracker",
    "Tracker",
    "load_skill",
    "save_skill",
    "sliding_windows",
]
