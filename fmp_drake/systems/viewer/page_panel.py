"""The panel beside the scene on the page: what is going on, in words."""

import json
import re
import threading
import time
import weakref
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Unpack
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import ProxyHandler, build_opener

from pydrake.geometry import Meshcat

from fmp_drake.errors import SystemsError
from fmp_drake.systems.viewer.panel_fields import PanelFields

# Seconds between two messages to a browser, and after which an idle one is sent.
_PAUSE, _IDLE = 0.1, 2.0
# Above Meshcat's own port, where that is free.
_PORT_OFFSET = 1000


class PagePanel:
    """Meshcat's page with a panel that says what is going on, at an address of its own.

    The panel's sliders and buttons are those of the Meshcat, whose page without the panel
    is served as before. What it says is given by `show`, which only keeps it:
    browsers are told by threads of their own, and there is nothing that they could change.

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
        self._board = _Board()
        server = _serve(host, meshcat.web_url(), self._board)
        name = urlsplit(meshcat.web_url()).hostname
        self.url = f"http://{name}:{server.server_port}/?tracked_camera=on"
        thread = threading.Thread(
            target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True
        )
        thread.start()
        self._finalizer = weakref.finalize(self, _stop, server, self._board)
        self._finalizer.atexit = False

    def show(self, **fields: Unpack[PanelFields]) -> None:
        """Show these fields from now on; the others stay as they are."""
        self._board.put(fields)

    @property
    def shown(self) -> PanelFields:
        """The fields that are shown."""
        return self._board.fields

    def close(self) -> None:
        """End the page; what is open in browsers stays as it is."""
        self._finalizer()


def add_panel(page: str, fields: PanelFields, *, port: int | None = None) -> str:
    """Return a page of Meshcat with a panel in it.

    Parameters
    ----------
    page : str
        HTML, as Meshcat serves it or `Meshcat.StaticHtml` returns it.
    fields : PanelFields
        What the panel says, at first.
    port : int, optional
        Where a page that is served beside its Meshcat finds it, on the same machine.

    Raises
    ------
    SystemsError
        Where it is no such page.
    """
    end = page.rfind("</body>")
    head = page.find("</head>")
    if min(head, end) < 0:
        raise SystemsError("a panel needs a page with a head and a body, as Meshcat's.")
    panel = Path(__file__).with_suffix(".html").read_text(encoding="utf-8")
    start = json.dumps({"fields": fields, "port": port}).replace("<", r"\u003c")
    title = str(fields.get("title", "fmp_drake")).replace("<", "&lt;")
    return "".join(
        (
            re.sub("<title>.*?</title>", "", page[:head], flags=re.DOTALL),
            f"<title>{title}</title><script>const fmpStart = {start};",
            _REDIRECT if port else "",
            "</script>",
            page[head:end],
            panel,
            page[end:],
        )
    )


# Meshcat's page looks for its Meshcat where it was served.
_REDIRECT = """
WebSocket = class extends WebSocket {
  constructor(url) {
    super(url.replace(location.host, `${location.hostname}:${fmpStart.port}`));
  }
};
"""


class _Board:
    """The fields, for the threads that tell browsers about them."""

    def __init__(self) -> None:
        self.fields: PanelFields = {}
        self.is_open = True
        self._version = 0
        self._changed = threading.Condition()

    def put(self, fields: PanelFields) -> None:
        with self._changed:
            self.fields = {**self.fields, **fields}
            self._version += 1
            self._changed.notify_all()

    def close(self) -> None:
        self.is_open = False
        self.put({})

    def after(self, version: int) -> tuple[int, PanelFields]:
        """Wait for a later version than this, but not for long."""
        with self._changed:
            self._changed.wait_for(lambda: self._version != version, timeout=_IDLE)
            return self._version, self.fields


def _serve(host: str, meshcat: str, board: _Board) -> ThreadingHTTPServer:
    """Bind a server that adds the panel to what Meshcat serves at its address."""
    fetch = build_opener(ProxyHandler({})).open  # It is on this machine.
    with fetch(meshcat) as answer:
        page = answer.read().decode()
    inner = urlsplit(meshcat).port or 80

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path = urlsplit(self.path).path
            try:
                if path in ("/", "/index.html"):
                    text = add_panel(page, board.fields, port=inner)
                    self._answer(text.encode(), "text/html; charset=utf-8")
                elif path == "/panel":
                    self._tell()
                else:
                    self._pass_on()
            except ConnectionError:
                pass  # The browser has gone.

        def _answer(self, body: bytes, kind: str, caching: str = "no-cache") -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Cache-Control", caching)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def _tell(self) -> None:
            """Send the fields whenever they change, as server-sent events."""
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            version = -1
            while board.is_open:
                version, fields = board.after(version)
                self.wfile.write(f"data: {json.dumps(fields)}\n\n".encode())
                time.sleep(_PAUSE)

        def _pass_on(self) -> None:
            """Fetch what the page needs besides from Meshcat."""
            try:
                with fetch(f"{meshcat}{self.path}") as answer:
                    body, about = answer.read(), answer.headers
            except HTTPError as error:
                self.send_error(error.code)
                return
            kind = about.get("Content-Type") or "application/octet-stream"
            self._answer(body, kind, about.get("Cache-Control") or "no-cache")

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    class Server(ThreadingHTTPServer):
        daemon_threads = True
        block_on_close = False

    here = "" if host == "*" else host
    try:
        return Server((here, inner + _PORT_OFFSET), Handler)
    except OSError:
        return Server((here, 0), Handler)


def _stop(server: ThreadingHTTPServer, board: _Board) -> None:
    """End a server, from any thread."""

    def stop() -> None:
        server.shutdown()
        server.server_close()

    board.close()
    threading.Thread(target=stop, daemon=True).start()
