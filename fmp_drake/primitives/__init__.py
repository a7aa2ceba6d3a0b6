"""Learning and playing Fourier movement primitives. No Drake in here."""

from fmp_drake.primitives.data.demonstration import Demonstration
from fmp_drake.primitives.data.placement import Placement, fit_placement
from fmp_drake.primitives.data.reading.reading_options import ReadingOptions
from fmp_drake.primitives.data.recordings import read_demonstrations
from fmp_drake.primitives.data.windows import sliding_windows
from fmp_drake.primitives.discrete.discrete_movement_primitive import (
    DiscreteMovementPrimitive,
)
from fmp_drake.primitives.discrete.via_points import ViaPoint
from fmp_drake.primitives.editing.modulation import modulate_skill, modulate_windows
from fmp_drake.primitives.editing.orientation import (
    add_orientation,
    angular_acceleration,
    angular_velocity,
    mean_rotation,
    rotation_vectors,
    rotations_of,
    skill_rotations,
)
from fmp_drake.primitives.editing.spectrum import (
    SpectralPeak,
    Spectrum,
    skill_spectrum,
    window_spectrum,
)
from fmp_drake.primitives.editing.transforms import scale_tempo, transform_space
from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.keypoint import Keypoint
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.mapping import Mapping, MappingPlan
from fmp_drake.primitives.model.movement_primitive import (
    PAPER_SETTINGS,
    FourierMovementPrimitive,
)
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.prediction import Prediction, PredictionPlan
from fmp_drake.primitives.model.region import DemonstratedRegion
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
    "DemonstratedRegion",
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
    "Motion",
    "PhaseModel",
    "Placement",
    "PlaybackState",
    "Player",
    "Prediction",
    "PredictionPlan",
    "ProportionalTracker",
    "ReadingOptions",
    "SpectralPeak",
    "Spectrum",
    "Tracker",
    "ViaPoint",
    "add_orientation",
    "angular_acceleration",
    "angular_velocity",
    "fit_placement",
    "load_skill",
    "mean_rotation",
    "modulate_skill",
    "modulate_windows",
    "read_demonstrations",
    "rotation_vectors",
    "rotations_of",
    "save_skill",
    "scale_tempo",
    "skill_rotations",
    "skill_spectrum",
    "sliding_windows",
    "transform_space",
    "window_spectrum",
]
