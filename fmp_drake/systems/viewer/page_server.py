"""The server of the page with its panel: a program of its own, without Drake.

Its arguments are the address of a Meshcat and the host to serve at. It prints the port
that it has, reads what the panel says from its input, a line of JSON at a time, and
ends with that. In the process of a simulation its threads would be where Python collects
garbage, and a Meshcat may end in the main thread only.
"""

import json
import re
import signal
import sys
import threading
import time
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import ProxyHandler, build_opener

# Seconds between two messages to a browser, and after which an idle one is sent.
_PAUSE, _IDLE = 0.1, 2.0
# Above Meshcat's own port, where that is free.
_PORT_OFFSET = 1000

# Meshcat's page looks for its Meshcat where it was served.
_REDIRECT = """
WebSocket = class extends WebSocket {
  constructor(url) {
    super(url.replace(location.host, `${location.hostname}:${fmpStart.port}`));
  }
};
"""


def with_panel(page: str, fields: Mapping[str, Any], *, port: int | None = None) -> str:
    """Return a page of Meshcat with a panel in it.

    Parameters
    ----------
    page : str
        HTML.
    fields : mapping
        What the panel says, at first.
    port : int, optional
        Where a page that is served beside its Meshcat finds it, on the same machine.
    """
    end = page.rfind("</body>")
    head = page.find("</head>")
    panel = Path(__file__).with_name("page_panel.html").read_text(encoding="utf-8")
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


class _Board:
    """The fields, for the threads that tell browsers about them."""

    def __init__(self) -> None:
        self.fields: Mapping[str, Any] = {}
        self._version = 0
        self._changed = threading.Condition()

    def put(self, fields: Mapping[str, Any]) -> None:
        with self._changed:
            self.fields = fields
            self._version += 1
            self._changed.notify_all()

    def after(self, version: int) -> tuple[int, Mapping[str, Any]]:
        """Wait for a later version than this, but not for long."""
        with self._changed:
            self._changed.wait_for(lambda: self._version != version, timeout=_IDLE)
            return self._version, self.fields


def _bind(host: str, meshcat: str, board: _Board) -> ThreadingHTTPServer:
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
                    text = with_panel(page, board.fields, port=inner)
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
            while True:
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


def _main() -> None:
    meshcat, host = sys.argv[1:]
    # Ctrl-C is for the program that started this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    board = _Board()
    server = _bind(host, meshcat, board)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdout.write(f"{server.server_port}\n")
    sys.stdout.flush()
    for line in sys.stdin:
        board.put(json.loads(line))


if __name__ == "__main__":
    _main()
