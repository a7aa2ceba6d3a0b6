"""Meshcat's page with a status panel beside the scene, served or saved."""

import contextlib
import json
import math
import os
import random
import secrets
import subprocess
import sys
import time
import weakref
from html import escape
from pathlib import Path
from typing import Literal, TypedDict, Unpack

from pydrake.geometry import Meshcat, MeshcatParams

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_type
from fmp_drake.processes import uninterrupted_start
from fmp_drake.systems.page.page_server import with_panel

# Longest log of a page.
_MOST_MESSAGES = 100
# Time in which a browser connects again while it reloads the page, s. On a slow network
# (1.6 Mbit/s) that takes 12 s the first time, and less with the browser's cache.
_RELOAD_TIME = 10.0

type Level = Literal["good", "busy", "bad", "idle"]
type Kind = Literal["area", "line", "arrow"]


class ButtonLook(TypedDict, total=False):
    """Appearance of a button of the page.

    Attributes
    ----------
    label : str
        Label, instead of its name.
    enabled : bool
        Whether it can be pressed.
    hint : str
        Tooltip.
    """

    label: str
    enabled: bool
    hint: str


class LegendEntry(TypedDict):
    """Entry of the legend: a colour of the scene and its meaning.

    Attributes
    ----------
    name : str
    color : str
        In CSS; that of the active component where it is empty.
    kind : str
        `area`, `line` or `arrow`.
    """

    name: str
    color: str
    kind: Kind


class Message(TypedDict):
    """A message of a run.

    Attributes
    ----------
    level : str
    text : str
        Event, and advice.
    """

    level: Level
    text: str


class PanelFields(TypedDict, total=False):
    """Contents of the panel. A field that was never set is not shown.

    Attributes
    ----------
    title, subtitle : str
        Of the panel; the title is also the tab's.
    mode : str
        Current activity, one or two words.
    level : str
        Severity, which determines the colour.
    detail : str
        A sentence about the mode, such as the reason of a stop.
    paused : bool
        Whether the run is paused, which is shown instead of the mode.
    time : float
        s.
    cleaned : float
        Fraction, from 0 to 1.
    force : float
        On the board, N.
    desired_force : float
        N.
    force_tolerance : float
        Tolerated difference of the force, N.
    component : str
        The active component.
    component_color : str
        In CSS.
    legend : list of LegendEntry
    help : list of str
        Instructions, one sentence each.
    buttons : dict of str to ButtonLook
        By the names given to `Meshcat.AddButton`; other buttons show their names.
    replay : dict of str to list of float
        Of a saved page with an animation: numbers of the panel by name, such as cleaned,
        at the times of `time`, s. It can then be paused and played again.
    messages : list of Message
        The latest one is shown, the others are in the log.
    progress : float or None
        Progress, from 0 to 1; None for no bar.
    rate : float
        Simulated seconds per second; shown below 0.9.
    summary : list of tuple of 2 str
        Names and results of a run that has ended.
    grab : str
        Effect of dragging the arm, such as ``you are pulling``; empty where the arm
        cannot be dragged.
    turn : str
        Name of a switch of the page that a drag with Shift turns on.
    ended : bool
        Whether the program is about to end.
    """

    title: str
    subtitle: str
    mode: str
    level: Level
    detail: str
    paused: bool
    time: float
    cleaned: float
    force: float
    desired_force: float
    force_tolerance: float
    component: str
    component_color: str
    legend: list[LegendEntry]
    help: list[str]
    buttons: dict[str, ButtonLook]
    replay: dict[str, list[float]]
    messages: list[Message]
    progress: float | None
    rate: float
    summary: list[tuple[str, str]]
    grab: str
    turn: str
    ended: bool


def hidden_meshcat() -> Meshcat:
    """Start a Meshcat at an address that no web page can guess.

    Meshcat accepts messages from every page that knows its address. This one listens at
    one of 16 million loopback addresses and at a random port; where the system has no
    such addresses, at a random port of localhost. A `PagePanel` leads browsers to it.
    """
    numbers = random.SystemRandom()
    own = ".".join(str(numbers.randint(1, 254)) for _ in range(3))
    for host in (f"127.{own}", "localhost"):
        with contextlib.suppress(RuntimeError):
            meshcat = Meshcat(MeshcatParams(host=host, port=0, show_stats_plot=False))
            for name in ("/Grid", "/Axes"):  # Else only these are visible at first.
                meshcat.SetProperty(name, "visible", False)
            return meshcat
    raise SystemsError("no port of this machine is free for Meshcat.")


class PagePanel:
    """Meshcat's page with a status panel, at its own address.

    The panel's sliders and buttons are those of the Meshcat. Only the page at `url`,
    which carries a token, may move them and pull the arm; without the token it may
    watch. That holds for a `hidden_meshcat`: any other Meshcat listens to all pages at
    its own address. A separate process sends the fields of `show` to browsers, and ends
    with this one. This process therefore has no threads, and a browser can neither
    change nor delay it.

    Parameters
    ----------
    meshcat : Meshcat
    host : str
        Address of this machine at which the page is served.

    Attributes
    ----------
    meshcat : Meshcat
    url : str
        Where to open the page.
    shown : dict
        The fields that are shown.

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> panel = PagePanel(Meshcat())
    >>> panel.show(title="table_top", mode="wiping", level="good", time=1.5)
    >>> panel.shown["mode"]
    'wiping'
    >>> panel.close()
    """

    def __init__(self, meshcat: Meshcat, *, host: str = "localhost") -> None:
        self.meshcat = meshcat
        self.shown: PanelFields = {}
        self._last_seen = -math.inf
        script = Path(__file__).with_name("page_server.py")
        with uninterrupted_start():
            process = subprocess.Popen(
                [sys.executable, script, meshcat.web_url(), host],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
        assert process.stdin is not None
        assert process.stdout is not None
        self._pipe = process.stdin
        self._finalizer = weakref.finalize(self, _stop, process)
        token = secrets.token_urlsafe(16)
        with contextlib.suppress(BrokenPipeError):
            self._pipe.write(f"{token}\n".encode())
            self._pipe.flush()
        port = process.stdout.readline().decode().strip()
        if not port.isdecimal():
            self.close()
            raise SystemsError(f"the page cannot be served at {host}: {port}")
        os.set_blocking(self._pipe.fileno(), False)
        self._unsent = b""
        name = "localhost" if host in ("*", "0.0.0.0") else host
        self.url = f"http://{name}:{port}/?token={token}&tracked_camera=on"

    def show(self, **fields: Unpack[PanelFields]) -> None:
        """Show these fields from now on; the others stay as they are."""
        self._look_for_browsers()
        self.shown = {**self.shown, **fields}
        # Where the server is too slow to read it, the next message has all fields. What was
        # written in part is completed first.
        message = json.dumps(self.shown).encode() + b"\n"
        with contextlib.suppress(BlockingIOError, BrokenPipeError, ValueError):
            for data in (self._unsent, message):
                self._unsent = data[os.write(self._pipe.fileno(), data) :]
                if self._unsent:
                    break

    def say(self, text: str, *, level: Level = "idle") -> None:
        """Show a message, and keep it in the log of the page."""
        messages = self.shown.get("messages", [])
        message: Message = {"level": level, "text": text}
        self.show(messages=[*messages, message][-_MOST_MESSAGES:])

    def is_open(self) -> bool:
        """Return whether a browser shows the page, or may be reloading it.

        A page counts as open for 10 s after a call, or new fields, that found it connected.
        """
        self._look_for_browsers()
        return time.monotonic() - self._last_seen < _RELOAD_TIME

    def _look_for_browsers(self) -> None:
        if self.meshcat.GetNumActiveConnections() > 0:
            self._last_seen = time.monotonic()

    def close(self) -> None:
        """End the page; open browsers keep their content."""
        self._finalizer()


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End the server by closing its input."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    process.wait()


def add_panel(page: str, fields: PanelFields) -> str:
    """Return a saved page of Meshcat with a panel in it.

    Parameters
    ----------
    page : str
        HTML, as `Meshcat.StaticHtml` returns it.
    fields : PanelFields
        Content of the panel.

    Raises
    ------
    SystemsError
        If the page has no head or body.
    """
    if min(page.find("</head>"), page.rfind("</body>")) < 0:
        raise SystemsError("a panel needs a page with a head and a body, as Meshcat's.")
    return with_panel(page, fields, live=False, watching=False)


class InlinePage:
    """A saved page that a notebook, or a gallery of examples, shows below its cell.

    The page is a part of the notebook: it can be turned and replayed without a server.

    Parameters
    ----------
    html : str
        The page, as `Meshcat.StaticHtml` or `WipingRun.html` returns it.
    height : int
        Pixels.

    Raises
    ------
    SystemsError
        If the page is not text, for example a Meshcat itself.

    Examples
    --------
    >>> page = InlinePage("<p>nothing to see</p>", height=50)
    >>> print(page._repr_html_())
    <iframe class="replay" title="replay" width="100%" height="50"
    srcdoc="&lt;p&gt;nothing to see&lt;/p&gt;"></iframe>
    """

    def __init__(self, html: str, *, height: int = 400) -> None:
        check_type(html, "html", str, error=SystemsError)
        self._html = html
        self._height = height

    def __repr__(self) -> str:
        """Return the text that replaces the page where it cannot be shown."""
        return f"InlinePage of {len(self._html) / 1e6:.1f} MB"

    def _repr_html_(self) -> str:
        """Return the HTML for IPython."""
        return (
            f'<iframe class="replay" title="replay" width="100%" height="{self._height}"\n'
            f'srcdoc="{escape(self._html)}"></iframe>'
        )
