"""Learning and playing Fourier movement primitives. No Drake in here."""

from fmp_drake.primitives.basis import FourierBasis
from fmp_drake.primitives.demonstration import Demonstration
from fmp_drake.primitives.discrete import DiscreteMovementPrimitive
from fmp_drake.primitives.discrete_movement import ViaPoint
from fmp_drake.primitives.keypoint import Keypoint
from fmp_drake.primitives.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.mapping import Mapping, MappingPlan
from fmp_drake.primitives.modulation import modulate_skill, modulate_windows
from fmp_drake.primitives.movement_primitive import (
    PAPER_SETTINGS,
    FourierMovementPrimitive,
)
from fmp_drake.primitives.orientation import add_orientation, skill_rotations
from fmp_drake.primitives.playback import Player
from fmp_drake.primitives.playback_state import PlaybackState
from fmp_drake.primitives.skill_file import load_skill, save_skill
from fmp_drake.primitives.spectrum import skill_spectrum, window_spectrum
from fmp_drake.primitives.tracking import (
    ExponentialTracker,
    LqrTracker,
    ProportionalTracker,
    Tracker,
)
from fmp_drake.primitives.transforms import scale_tempo, transform_space
from fmp_drake.primitives.windows import sliding_windows

__all__ = [
    "PAPER_SETTINGS",
    "Demonstration",
    "DiscreteMovementPrimitive",
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
    "ViaPoint",
    "add_orientation",
    "load_skill",
    "modulate_skill",
    "modulate_windows",
    "save_skill",
    "scale_tempo",
    "skill_rotations",
    "skill_spectrum",
    "sliding_windows",
    "transform_space",
    "window_spectrum",
]
