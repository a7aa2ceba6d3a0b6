"""What the panel of the page can say."""

from typing import Literal, TypedDict

type Kind = Literal["area", "line", "arrow"]


class ButtonLook(TypedDict, total=False):
    """How a button of the page looks now.

    Attributes
    ----------
    label : str
        What is on it, instead of its name.
    enabled : bool
        Whether it can be pressed.
    hint : str
        What is shown while the mouse is over it.
    """

    label: str
    enabled: bool
    hint: str


class LegendEntry(TypedDict):
    """A colour of the scene, and what it stands for.

    Attributes
    ----------
    name : str
    color : str
        In CSS; of the component that plays where it is empty.
    kind : str
        `area`, `line` or `arrow`.
    """

    name: str
    color: str
    kind: Kind


class PanelFields(TypedDict, total=False):
    """What the panel says. A field that was never given is not shown.

    Attributes
    ----------
    title, subtitle : str
        Of the panel; the title is also the tab's.
    mode : str
        What is being done, in a word or two.
    level : str
        How well that is: decides the colour.
    detail : str
        A sentence about the mode, such as the reason of a stop.
    paused : bool
        Is shown instead of the mode.
    time : float
        s.
    cleaned : float
        Fraction, from 0 to 1.
    force : float
        On the board, N.
    force_band : tuple of 2 floats
        Within which the force is good, N.
    component : str
        Which one plays.
    component_color : str
        In CSS.
    legend : list of LegendEntry
    help : list of str
        How to use the page, in sentences.
    buttons : dict of str to ButtonLook
        By the names that `Meshcat.AddButton` was given; others look like their names.
    replay : dict of str to list of float
        Of a saved page with an animation: numbers of the panel by name, such as cleaned,
        at the times of `time`, s. It can then be paused and played again.
    """

    title: str
    subtitle: str
    mode: str
    level: Literal["good", "busy", "bad", "idle"]
    detail: str
    paused: bool
    time: float
    cleaned: float
    force: float
    force_band: tuple[float, float]
    component: str
    component_color: str
    legend: list[LegendEntry]
    help: list[str]
    buttons: dict[str, ButtonLook]
    replay: dict[str, list[float]]
