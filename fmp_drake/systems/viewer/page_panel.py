"""The panel beside the scene on the page: what is going on, in words."""

import contextlib
import json
import os
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Unpack
from urllib.parse import urlsplit

from pydrake.geometry import Meshcat

from fmp_drake.errors import SystemsError
from fmp_drake.systems.viewer.page_server import with_panel
from fmp_drake.systems.viewer.panel_fields import PanelFields


class PagePanel:
    """Meshcat's page with a panel that says what is going on, at an address of its own.

    The panel's sliders and buttons are those of the Meshcat, whose page without the panel
    is served as before. What it says is given by `show`, and told to browsers by a
    process of its own, which ends with this one: here there are no threads, and nothing
    that a browser could change or delay.

    Parameters
    ----------
    meshcat : Meshcat
    host : str
        Address of this machine at which the page is served, as the Meshcat's.

    Attributes
    ----------
    meshcat : Meshcat
    url : str
        Where to open the page.

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
        self._shown: PanelFields = {}
        script = Path(__file__).with_name("page_server.py")
        process = subprocess.Popen(
            [sys.executable, script, meshcat.web_url(), host],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        self._pipe = process.stdin
        self._finalizer = weakref.finalize(self, _stop, process)
        port = process.stdout.readline().decode().strip()
        if not port:
            self.close()
            raise SystemsError(f"the page cannot be served at {host}.")
        os.set_blocking(self._pipe.fileno(), False)
        self.url = (
            f"http://{urlsplit(meshcat.web_url()).hostname}:{port}/?tracked_camera=on"
        )

    def show(self, **fields: Unpack[PanelFields]) -> None:
        """Show these fields from now on; the others stay as they are."""
        self._shown = {**self._shown, **fields}
        # Where the server does not come to read it, a later one tells as much.
        with contextlib.suppress(BlockingIOError, BrokenPipeError, ValueError):
            os.write(self._pipe.fileno(), json.dumps(self._shown).encode() + b"\n")

    @property
    def shown(self) -> PanelFields:
        """The fields that are shown."""
        return self._shown

    def close(self) -> None:
        """End the page; what is open in browsers stays as it is."""
        self._finalizer()


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End the server, by the end of what it reads."""
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
        What the panel says.

    Raises
    ------
    SystemsError
        Where it is no such page.
    """
    if min(page.find("</head>"), page.rfind("</body>")) < 0:
        raise SystemsError("a panel needs a page with a head and a body, as Meshcat's.")
    return with_panel(page, fields)
