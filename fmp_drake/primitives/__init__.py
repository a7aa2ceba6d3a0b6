"""Fourier movement primitives: learned from recordings, played, edited. No Drake."""

from fmp_drake.primitives.data.demonstration import (
    Demonstration,
    add_orientation,
    read_demonstrations,
)
from fmp_drake.primitives.data.orientation import angular_velocity, skill_rotations
from fmp_drake.primitives.data.reading.table import ReadingOptions
from fmp_drake.primitives.data.windows import sliding_windows
from fmp_drake.primitives.discrete.discrete_movement_primitive import (
    DiscreteMovementPrimitive,
    ViaPoint,
)
from fmp_drake.primitives.editing.spectrum import modulate_skill, skill_spectrum
from fmp_drake.primitives.editing.transforms import scale_tempo, transform_space
from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.mapping import Keypoint
from fmp_drake.primitives.model.movement_primitive import (
    PAPER_SETTINGS,
    FourierMovementPrimitive,
)
from fmp_drake.primitives.model.phase.rhythm import Rhythm
from fmp_drake.primitives.model.phase.search import find_rhythm
from fmp_drake.primitives.model.skill_file import load_skill, save_skill
from fmp_drake.primitives.playback.motion import Motion
from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.player import Player
from fmp_drake.primitives.playback.trackers import (
    ExponentialTracker,
    LqrTracker,
    ProportionalTracker,
    Tracker,
)

__all__ = [
    "PAPER_SETTINGS",
    "Demonstration",
    "DiscreteMovementPrimitive",
    "ExponentialTracker",
    "FourierBasis",
    "FourierMovementPrimitive",
    "Keypoint",
    "LqrTracker",
    "Motion",
    "PlaybackState",
    "Player",
    "ProportionalTracker",
    "ReadingOptions",
    "Rhythm",
    "Tracker",
    "ViaPoint",
    "add_orientation",
    "angular_velocity",
    "find_rhythm",
    "load_skill",
    "modulate_skill",
    "read_demonstrations",
    "save_skill",
    "scale_tempo",
    "skill_rotations",
    "skill_spectrum",
    "sliding_windows",
    "transform_space",
]
