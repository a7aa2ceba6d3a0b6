"""Something that went wrong in a run."""

from typing import NamedTuple


class RunEvent(NamedTuple):
    """Something that went wrong in a run, once or several times.

    Attributes
    ----------
    start, end : float
        Of the longest time that it lasted, s.
    kind : str
        In a few words.
    text : str
        A sentence about all times.

    Examples
    --------
    >>> event = RunEvent(12.3, 13.1, "contact lost", "contact lost from 12.3 to 13.1 s")
    >>> round(event.end - event.start, 1)
    0.8
    """

    start: float
    end: float
    kind: str
    text: str
