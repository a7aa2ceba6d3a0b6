"""What the primitive's system remembers beside the playback's arrays."""

import math
from typing import NamedTuple


class PlaybackBook(NamedTuple):
    """What is known since the last event.

    Attributes
    ----------
    step, component, remaps
        Of the playback's state.
    time : float
        Of the event, s.
    rest, tempo, slope, sample, blend_time
        As in `LiveState`.
    reactive : float
        Number of reactive re-mappings.
    pushed_since : float
        When the robot left its path, s; infinity where it is on it.
    """

    step: float
    component: float = 0.0
    remaps: float = 0.0
    time: float = 0.0
    rest: float = 0.0
    tempo: float = 1.0
    slope: float = 0.0
    sample: float = 0.0
    blend_time: float = 0.0
    reactive: float = 0.0
    pushed_since: float = math.inf
