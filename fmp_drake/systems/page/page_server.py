"""Server of the page with its panel: a separate program, without Drake.

Its arguments are the address of a Meshcat and the host to serve at. It prints its port.
The first line of its input is the operator's token, every further line the fields of the
panel as JSON; the server ends with its input. In the process of a simulation its threads
could collect Python's garbage, but a Meshcat must be destroyed in the main thread.

The server is the only way from a browser to the Meshcat. A request must name this machine
as its host, so that no other site's name leads here. A WebSocket must come from this page.
Only one that carries the token may send more than control frames.
"""

import contextlib
import hmac
import io
import ipaddress
import json
import os
import re
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

# Least and greatest time between two messages to a browser, s.
_PAUSE, _IDLE = 0.1, 2.0
# Time limits for the whole head of a request, and for a silent peer, s.
_TIMEOUT = 10.0
# Connections at the same time, and those that may stay without the token. The others are
# for the operator and for short requests.
_MAX_CONNECTIONS, _MAX_WATCHING = 64, 48
# Purposes of connections. Those for short requests make room for newer ones.
_REQUEST, _WATCHING, _OPERATING = "request", "watching", "operating"
# First bytes of complete close, ping and pong frames, and the bits of the second byte.
_CONTROL_FRAMES, _MASKED, _LONGEST_CONTROL = (0x88, 0x89, 0x8A), 0x80, 125
# Path of the files of meshes, and waits for one that is missing, s.
_MESHES, _WAITS = "/cas-v1/", (0.1, 0.3, 1.0)
_PORTS = range(8000, 8100)
_OWN_PATH = re.compile(r"/[\w./-]*", re.ASCII)
# Host of a request: an IPv6 address or a name, and a port.
_HOST = re.compile(r"(\[(?P<address>[\da-f.:]+)\]|(?P<name>[\w.-]+))(:\d*)?", re.ASCII)
_HANDSHAKE = (
    "Upgrade",
    "Connection",
    "Sec-WebSocket-Key",
    "Sec-WebSocket-Version",
    "Sec-WebSocket-Extensions",
)


def with_panel(page: str, fields: Mapping[str, Any], **start: bool) -> str:
    """Return a page of Meshcat with a panel in it.

    Parameters
    ----------
    page : str
        HTML.
    fields : mapping
        Initial content of the panel.
    **start : bool
        `live`: whether the panel follows a server. `watching`: whether the page may only
        watch.
    """
    end = page.rfind("</body>")
    head = page.find("</head>")
    panel = Path(__file__).with_name("page_panel.html").read_text(encoding="utf-8")
    text = json.dumps({"fields": fields, **start}).replace("<", r"\u003c")
    title = str(fields.get("title", "fmp_drake")).replace("<", "&lt;")
    return "".join(
        (
            re.sub("<title>.*?</title>", "", page[:head], flags=re.DOTALL),
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{title}</title><script>const fmpStart = {text};</script>",
            page[head:end],
            panel,
            page[end:],
        )
    )


def is_own_host(header: str, served_at: str) -> bool:
    """Return whether the Host of a request names this machine.

    A numeric address cannot be another site's name. Only the names of this machine are
    accepted.

    Parameters
    ----------
    header : str
        With or without a port.
    served_at : str
        The host that the page is served at.
    """
    parts = _HOST.fullmatch(header.lower())
    if parts is None:
        return False
    name = parts["address"] or parts["name"]
    if name in {"localhost", served_at.lower(), socket.gethostname().lower()}:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class ControlFrames:
    """Filter of a browser's WebSocket stream that drops all but control frames (RFC 6455).

    It passes only frames of unambiguous size: Meshcat would take the rest of a longer
    frame, or of one without a mask, for a separate message.
    """

    def __init__(self) -> None:
        self._buffer = b""
        self._skipped = 0

    def filter(self, data: bytes) -> bytes:
        """Return the control frames that are complete with the next bytes of the stream.

        Raises
        ------
        ConnectionError
            Where a frame is not masked; a browser masks all of them.
        """
        self._buffer += data
        frames = b""
        while True:
            dropped = min(self._skipped, len(self._buffer))
            self._buffer = self._buffer[dropped:]
            self._skipped -= dropped
            if len(self._buffer) < 2:
                return frames
            first, second = self._buffer[:2]
            if not second & _MASKED:
                raise ConnectionError("a frame without a mask")
            if (size := _frame_size(self._buffer)) is None:
                return frames
            if first not in _CONTROL_FRAMES or second & ~_MASKED > _LONGEST_CONTROL:
                self._skipped = size
                continue
            if len(self._buffer) < size:
                return frames
            frames += self._buffer[:size]
            self._buffer = self._buffer[size:]


def _frame_size(data: bytes) -> int | None:
    """Return the size of the first, masked frame with its head, bytes; None if cut off."""
    length, head = data[1] & ~_MASKED, 2
    if length > _LONGEST_CONTROL:
        extended = 2 if length == 126 else 8
        if len(data) < head + extended:
            return None
        length = int.from_bytes(data[head : head + extended], "big")
        head += extended
    return head + 4 + length


class _PanelState:
    """The fields, for the threads that send them to browsers."""

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
        """Wait for a limited time for a later version than this."""
        with self._changed:
            self._changed.wait_for(lambda: self._version != version, timeout=_IDLE)
            return self._version, self.fields


class _HeadReader(io.RawIOBase):
    """Reader of a connection that bounds the time of all its reads together.

    A peer that sends single bytes slowly would otherwise occupy its thread.
    """

    def __init__(self, connection: socket.socket, seconds: float) -> None:
        self._connection, self._end = connection, time.monotonic() + seconds

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        remaining = self._end - time.monotonic()
        if remaining <= 0:
            raise TimeoutError("the head of the request is not complete")
        self._connection.settimeout(remaining)
        return self._connection.recv_into(buffer)


class _Server(ThreadingHTTPServer):
    """A server with a bounded number of connections that prints nothing.

    Where all places are taken, a new connection replaces the oldest one whose request
    has not been answered yet: endless requests block nobody.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = _MAX_CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: Any) -> None:
        super().__init__(address, handler)
        self._lock = threading.Lock()
        self._purposes: dict[Any, str] = {}  # By connection, the oldest first.

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._lock:
            if len(self._purposes) == _MAX_CONNECTIONS:
                self._drop_oldest_request()
            if is_free := len(self._purposes) < _MAX_CONNECTIONS:
                self._purposes[request] = _REQUEST
        if is_free:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def _drop_oldest_request(self) -> None:
        for connection, purpose in self._purposes.items():
            if purpose == _REQUEST:
                del self._purposes[connection]
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)  # It ends its thread.
                return

    def keep(self, connection: socket.socket, purpose: str) -> bool:
        """Accept a connection; return whether there was a free place."""
        with self._lock:
            watching = sum(each == _WATCHING for each in self._purposes.values())
            is_full = purpose == _WATCHING and watching >= _MAX_WATCHING
            if is_full or connection not in self._purposes:
                return False
            self._purposes[connection] = purpose
            return True

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._lock:
                self._purposes.pop(request, None)

    def handle_error(self, *_: object) -> None:
        """Ignore the error: a browser has closed the connection, or sent invalid data."""


def _relay(
    browser: socket.socket, upstream: socket.socket, control: ControlFrames | None
) -> None:
    """Relay data until one side closes; from a watcher only control frames."""
    while True:
        ready, _, _ = select.select([browser, upstream], [], [])
        if upstream in ready:
            if not (data := upstream.recv(1 << 16)):
                return
            browser.sendall(data)
        if browser in ready:
            if not (data := browser.recv(1 << 16)):
                return
            upstream.sendall(control.filter(data) if control else data)


def _bind(
    host: str, meshcat: str, token: str, panel: _PanelState
) -> ThreadingHTTPServer:
    """Bind a server that adds the panel to what Meshcat serves at its address."""
    inner = urlsplit(meshcat)
    address = (inner.hostname or "localhost", inner.port or 80)

    def fetch(path: str) -> tuple[int, bytes, Any]:
        connection = HTTPConnection(*address, timeout=_TIMEOUT)
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            return answer.status, answer.read(), answer.headers
        finally:
            connection.close()

    page = fetch("/")[1].decode()

    class Handler(BaseHTTPRequestHandler):
        server: _Server

        def setup(self) -> None:
            super().setup()
            self.rfile.close()
            self.rfile = io.BufferedReader(_HeadReader(self.connection, _TIMEOUT))

        def do_GET(self) -> None:
            self.connection.settimeout(_TIMEOUT)
            hosts = self.headers.get_all("Host", [])
            own = hosts[0] if len(hosts) == 1 else ""
            path, _, query = self.path.partition("?")
            given_token = parse_qs(query).get("token", [""])[-1]
            may_act = hmac.compare_digest(given_token.encode(), token.encode())
            if not is_own_host(own, host):
                self.send_error(403, "this page is served to its own address only")
            elif not _OWN_PATH.fullmatch(path) or ".." in path:
                self.send_error(404)
            elif self.headers.get("Upgrade", "").lower() == "websocket":
                if self.headers.get("Origin", f"http://{own}") != f"http://{own}":
                    self.send_error(403, "another page may not connect to this one")
                else:
                    control = None if may_act else ControlFrames()
                    self._serve_persistent(may_act, lambda: self._join(control))
            elif path in ("/", "/index.html"):
                text = with_panel(page, panel.fields, live=True, watching=not may_act)
                self._answer(text.encode(), "text/html; charset=utf-8")
            elif path == "/panel":
                self._serve_persistent(may_act, self._follow)
            else:
                self._pass_on(path)

        def _answer(self, body: bytes, kind: str, caching: str = "no-cache") -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Cache-Control", caching)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            self.wfile.write(body)

        def _serve_persistent(self, may_act: bool, serve: Callable[[], None]) -> None:
            """Serve a connection that stays; only a bounded number without the token."""
            if self.server.keep(self.connection, _OPERATING if may_act else _WATCHING):
                serve()
            else:
                self.send_error(503, "too many pages are watching; close one of them")

        def _follow(self) -> None:
            """Send the fields whenever they change, as server-sent events."""
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            version = -1
            while True:
                version, fields = panel.after(version)
                self.wfile.write(f"data: {json.dumps(fields)}\n\n".encode())
                time.sleep(_PAUSE)

        def _pass_on(self, path: str) -> None:
            """Fetch the other files of the page from Meshcat.

            Files of meshes are missing for a moment where a scene is drawn again.
            """
            try:
                status, body, headers = fetch(path)
                for wait in _WAITS if path.startswith(_MESHES) else ():
                    if status != 404:
                        break
                    time.sleep(wait)
                    status, body, headers = fetch(path)
            except (OSError, HTTPException):
                self.send_error(502)
                return
            if status != 200:
                self.send_error(status)
                return
            kind = headers.get("Content-Type") or "application/octet-stream"
            self._answer(body, kind, headers.get("Cache-Control") or "no-cache")

        def _join(self, control: ControlFrames | None) -> None:
            """Join the browser's WebSocket to Meshcat's; a watching one by its control frames."""
            self.close_connection = True
            with socket.create_connection(address, timeout=_TIMEOUT) as upstream:
                head = ["GET / HTTP/1.1", f"Host: {inner.netloc}"]
                for name in _HANDSHAKE:
                    if value := self.headers.get(name):
                        head.append(f"{name}: {value}")
                upstream.sendall("\r\n".join([*head, "", ""]).encode())
                _relay(self.connection, upstream, control)

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    bound_host = "" if host == "*" else host
    for port in _PORTS:
        try:
            return _Server((bound_host, port), Handler)
        except OSError:
            continue
    return _Server((bound_host, 0), Handler)


def _answer(line: str) -> None:
    """Report the port, or the error, to the parent program."""
    try:
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    except BrokenPipeError:
        os._exit(1)  # That program has ended.


def _main() -> None:
    meshcat, host = sys.argv[1:]
    # Ctrl-C is for the program that started this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    panel = _PanelState()
    try:
        server = _bind(host, meshcat, sys.stdin.readline().strip(), panel)
    except (OSError, HTTPException) as error:
        _answer(str(error))
        return
    threading.Thread(target=server.serve_forever, daemon=True).start()
    _answer(str(server.server_port))
    for line in sys.stdin:
        with contextlib.suppress(ValueError):  # The last one may be incomplete.
            panel.put(json.loads(line))
    if panel.fields.get("ended"):
        # Until browsers have received the last fields.
        time.sleep(3 * _PAUSE)


if __name__ == "__main__":
    _main()
