"""Facts about the panel of the page, and about a page in a notebook."""

import contextlib
import hashlib
import http.client
import json
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import umsgpack
from browser import needs_chromium, screenshot
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import Box, Mesh, Meshcat, Rgba

from fmp_drake.errors import SystemsError
from fmp_drake.systems.page import page_server
from fmp_drake.systems.page.page_panel import (
    InlinePage,
    PagePanel,
    add_panel,
    hidden_meshcat,
)
from fmp_drake.systems.page.page_server import ControlFrames


@pytest.fixture
def panel():
    panel = PagePanel(hidden_meshcat())
    yield panel
    panel.close()


def ask(panel, path, **headers):
    """Return status, type and text of an answer of the page's server."""
    parts = urlsplit(panel.url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    try:
        return answer.status, answer.headers["Content-Type"], answer.read().decode()
    finally:
        connection.close()


def told(panel):
    """Yield what a browser is told about the panel."""
    parts = urlsplit(panel.url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    connection.request("GET", "/panel")
    answer = connection.getresponse()
    assert answer.headers["Content-Type"] == "text/event-stream"
    try:
        while line := answer.readline():
            if line.startswith(b"data: "):
                yield json.loads(line[6:])
    finally:
        connection.close()


class Viewed:
    """A Meshcat with a number of browsers."""

    viewers = 0

    def GetNumActiveConnections(self):
        return self.viewers


def test_page_counts_as_open_while_a_browser_may_reload_it(panel, monkeypatch):
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    panel.meshcat = Viewed()
    assert not panel.is_open()
    panel.meshcat.viewers = 1
    assert panel.is_open()
    panel.meshcat.viewers, now = 0, 109.0
    assert panel.is_open()
    now = 111.0
    assert not panel.is_open()


def test_page_of_a_run_may_be_reloaded_when_it_is_first_asked_for(panel, monkeypatch):
    """As at 60 s, the default duration: until then the run only shows its state."""

    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    panel.meshcat = Viewed()
    panel.meshcat.viewers = 1
    panel.show(time=59.9)
    panel.meshcat.viewers, now = 0, 109.0
    panel.show(time=60.0)
    assert panel.is_open()
    now = 111.0
    assert not panel.is_open()


def test_the_page_is_meshcat_s_with_a_panel_and_a_title(panel):
    panel.show(title="words <b>")
    said = told(panel)
    while not next(said):
        pass
    status, kind, page = ask(panel, "/")
    assert (status, kind) == (200, "text/html; charset=utf-8")
    assert page.count("<title>") == 1
    assert "<title>words &lt;b></title>" in page
    assert 'id="fmp-panel"' in page
    assert "new MeshCat.Viewer" in page


def test_other_files_of_the_page_come_from_meshcat(panel):
    _, _, page = ask(panel, "/")
    script = page.split('src="cas-v1/')[1].split('"')[0]
    status, _, text = ask(panel, f"/cas-v1/{script}")
    assert status == 200
    assert "gui_controllers" in text
    assert ask(panel, "/nothing")[0] == 404


def test_the_file_of_a_mesh_that_is_drawn_again_is_not_missing(panel, tmp_path):
    raw = bytes(36)  # Three corners.
    (tmp_path / "triangle.bin").write_bytes(raw)
    accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    accessor |= {"min": [0, 0, 0], "max": [0, 0, 0]}
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "triangle.bin", "byteLength": len(raw)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(raw)}],
        "accessors": [accessor],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
    }
    path = tmp_path / "triangle.gltf"
    path.write_text(json.dumps(content))

    def draw():
        panel.meshcat.SetObject("triangle", Mesh(str(path)), Rgba(1, 0, 0))

    file = f"/cas-v1/{hashlib.sha256(raw).hexdigest()}"
    draw()
    assert ask(panel, file)[0] == 200
    # A browser asks for it after the scene was cleared, and before it is drawn again.
    panel.meshcat.Delete("triangle")
    with ThreadPoolExecutor() as browser:
        answer = browser.submit(ask, panel, file)
        time.sleep(0.2)
        draw()
        assert answer.result()[0] == 200
    panel.meshcat.Delete("triangle")
    assert ask(panel, file)[0] == 404


def test_browser_receives_the_panel_and_its_changes(panel):
    panel.show(mode="wiping", time=1.0)
    events = told(panel)
    first = {"mode": "wiping", "time": 1.0}
    assert first in (next(events), next(events))
    panel.show(time=2.0)
    assert next(events) == {"mode": "wiping", "time": 2.0}
    events.close()


def upgrade(panel, query="", **headers):
    """Ask for a WebSocket and return its stream and the status of the answer."""
    parts = urlsplit(panel.url)
    own = {
        "Host": parts.netloc,
        "Origin": f"http://{parts.netloc}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    lines = [f"{name}: {value}" for name, value in {**own, **headers}.items()]
    stream = socket.create_connection((parts.hostname, parts.port), timeout=20)
    stream.sendall("\r\n".join([f"GET /?{query} HTTP/1.1", *lines, "", ""]).encode())
    answer = b""
    while b"\r\n\r\n" not in answer and (data := stream.recv(1)):
        answer += data
    return stream, int(answer.split()[1])


def move_slider(stream, value):
    """Send what Meshcat's page sends when the slider `force` is moved."""
    message = umsgpack.packb({"type": "slider", "name": "force", "value": value})
    # A browser masks what it sends; this mask changes nothing.
    stream.sendall(bytes([0x82, 0x80 | len(message), 0, 0, 0, 0]) + message)


@pytest.fixture
def sliding(panel):
    panel.meshcat.AddSlider("force", 0.0, 15.0, 0.5, 10.0)
    return panel


def value_after(panel, value, seconds=5.0):
    """Wait until the slider has a value, and return the one that it has."""
    end = time.monotonic() + seconds
    while panel.meshcat.GetSliderValue("force") != value and time.monotonic() < end:
        time.sleep(0.02)
    return panel.meshcat.GetSliderValue("force")


def test_the_page_with_the_token_moves_a_slider(sliding):
    stream, status = upgrade(sliding, urlsplit(sliding.url).query)
    move_slider(stream, 12.0)
    assert status == 101
    assert value_after(sliding, 12.0) == 12.0
    stream.close()


@pytest.mark.parametrize("query", ["", "token=", "token=guess", "token=%00"])
def test_a_page_without_the_token_may_only_watch(sliding, query):
    stream, status = upgrade(sliding, query)
    assert status == 101
    # What stands in the scene reaches it.
    assert stream.recv(1 << 16)
    move_slider(stream, 12.0)
    acting, _ = upgrade(sliding, urlsplit(sliding.url).query)
    move_slider(acting, 7.0)
    assert value_after(sliding, 7.0) == 7.0
    move_slider(stream, 12.0)
    assert value_after(sliding, 12.0, seconds=0.5) == 7.0
    for each in (stream, acting):
        each.close()


@pytest.mark.parametrize("head", [b"\x89\x04", b"\x89\x7e\x00\x04", b"\x0b\x04"])
def test_a_frame_without_a_mask_ends_the_connection_of_a_watcher(sliding, head):
    stream, _ = upgrade(sliding)
    message = umsgpack.packb({"type": "slider", "name": "force", "value": 12.0})
    # Meshcat takes four bytes more for the first frame: the head of the second one.
    body = b"\0\0" + frame(2, message)
    stream.sendall(head + b"\0\0\0\0" + frame(9, body, masked=False))
    while stream.recv(1 << 16):
        pass  # The scene; then the connection ends.
    assert value_after(sliding, 12.0, seconds=0.5) == 10.0
    stream.close()


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost:1"},
        {"Host": "evil.example:8000"},
        {"Host": "localhost.evil.example"},
        {"Host": "evil.example@localhost"},
        {"Host": "localhost/evil.example"},
        {"Host": ""},
    ],
)
def test_another_page_s_web_socket_is_refused_even_with_the_token(sliding, headers):
    stream, status = upgrade(sliding, urlsplit(sliding.url).query, **headers)
    assert status == 403
    stream.close()


@pytest.mark.parametrize("path", ["/", "/panel", "/meshcat.js"])
def test_a_foreign_name_for_this_machine_is_refused(panel, path):
    assert ask(panel, path, Host="evil.example:8000")[0] == 403


def status_of(panel, *hosts, upgrades, version="1.1"):
    """Return the status of an answer to a request with these lines of Host."""
    parts = urlsplit(panel.url)
    lines = [
        f"GET /?{parts.query} HTTP/{version}",
        *(f"Host: {host}" for host in hosts),
    ]
    if upgrades:
        lines += [
            *("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"),
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        ]
    with socket.create_connection((parts.hostname, parts.port), timeout=20) as stream:
        stream.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(stream.makefile("rb").readline().split()[1])


@pytest.mark.parametrize("upgrades", [False, True])
@pytest.mark.parametrize(
    ("hosts", "is_own"),
    [
        (["localhost:{port}"], True),
        (["LOCALHOST:{port}"], True),
        (["127.0.0.1:{port}"], True),
        (["[::1]:{port}"], True),
        (["[::ffff:127.0.0.1]:{port}"], True),
        (["localhost.:{port}"], False),
        (["evil.example:{port}"], False),
        (["EVIL.example.:{port}"], False),
        (["127.0.0.1.evil.example:{port}"], False),
        (["[::1].evil.example:{port}"], False),
        (["[evil.example]:{port}"], False),
        (["0x7f.1:{port}"], False),
        (["localhost:{port}, evil.example"], False),
        (["localhost:{port}", "evil.example:{port}"], False),
        (["evil.example:{port}", "localhost:{port}"], False),
        (["localhost:{port}", "localhost:{port}"], False),
        ([], False),
    ],
)
def test_one_host_that_is_this_machine_is_needed(panel, hosts, is_own, upgrades):
    port = urlsplit(panel.url).port
    hosts = [host.format(port=port) for host in hosts]
    expected = (101 if upgrades else 200) if is_own else 403
    assert status_of(panel, *hosts, upgrades=upgrades) == expected


def test_a_client_led_here_by_another_name_is_refused(panel, monkeypatch):
    # As by DNS rebinding: the name of another site leads to this machine.
    lookup = socket.getaddrinfo
    monkeypatch.setattr(
        socket,
        "getaddrinfo",
        lambda host, *rest, **options: lookup(
            "127.0.0.1" if host == "evil.example" else host, *rest, **options
        ),
    )
    url = panel.url.replace("localhost", "evil.example")
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(url, timeout=20)
    assert urllib.request.urlopen(panel.url, timeout=20).status == 200


def test_a_hidden_meshcat_is_not_at_the_usual_address():
    meshcat = hidden_meshcat()
    assert re.fullmatch(r"127\.\d+\.\d+\.\d+", urlsplit(meshcat.web_url()).hostname)
    assert hidden_meshcat().web_url() != meshcat.web_url()
    with pytest.raises(ConnectionError):
        socket.create_connection(("localhost", meshcat.port()), timeout=5)
    # Before there is a scene it is empty.
    for name in ("/Grid", "/Axes"):
        hidden = umsgpack.unpackb(meshcat._GetPackedProperty(name, "visible"))
        assert hidden["value"] is False


@pytest.mark.parametrize(
    "path", ["64725/private", "http://localhost:1/", "//..//x", "*"]
)
def test_only_paths_of_its_own_are_served(panel, path, capfd):
    assert ask(panel, path)[0] in (404, 403)
    assert capfd.readouterr().err == ""


def test_silent_connections_take_a_bounded_number_of_threads(panel):
    parts = urlsplit(panel.url)
    address = parts.hostname, parts.port
    silent = [socket.create_connection(address, timeout=20) for _ in range(80)]
    # The oldest have made room for the latest.
    assert [each.recv(1) for each in silent[:16]] == [b""] * 16
    assert ask(panel, "/")[0] == 200
    for each in silent:
        each.close()


@pytest.fixture
def served():
    """Serve the page with a short bound in another process, and return its address."""
    meshcat = Meshcat()
    program = "import page_server as server; server._TIMEOUT = 4.0; server._main()"
    with subprocess.Popen(
        [sys.executable, "-c", program, meshcat.web_url(), "localhost"],
        cwd=Path(page_server.__file__).parent,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:
        server.stdin.write("secret\n")
        server.stdin.flush()
        yield "localhost", int(server.stdout.readline())
        server.stdin.close()


def answer_of(address, path):
    connection = http.client.HTTPConnection(*address, timeout=20)
    try:
        connection.request("GET", path)
        return connection.getresponse().status
    except (ConnectionError, http.client.HTTPException):
        return None  # Turned away.
    finally:
        connection.close()


def drip(connections):
    """Send the next byte of each request."""
    for each in connections:
        with contextlib.suppress(OSError):
            each.sendall(b"x")


def begin(address, request):
    """Send the beginning of a request, and return its connection."""
    connection = socket.create_connection(address, timeout=20)
    connection.sendall(request)
    return connection


def watch(address):
    """Watch the panel without the token."""
    return begin(address, b"GET /panel HTTP/1.1\r\nHost: localhost\r\n\r\n")


def test_requests_that_never_end_do_not_keep_the_operator_out(served):
    watching, slow = [watch(served) for _ in range(48)], []
    for each in watching:
        assert each.recv(12)[9:] == b"200"
    # More and more of them, as often as the operator tries.
    for _ in range(5):
        slow += [begin(served, b"GET / HTTP/1.1\r\nX: ") for _ in range(64)]
        drip(slow)
        assert answer_of(served, "/?token=secret") == 200
    operator = begin(
        served, b"GET /panel?token=secret HTTP/1.1\r\nHost: localhost\r\n\r\n"
    )
    assert operator.recv(12)[9:] == b"200"
    slow += [begin(served, b"GET / HTTP/1.1\r\nX: ") for _ in range(64)]
    # Who is in stays in.
    for each in (operator, *watching):
        assert each.recv(12)
    for each in (operator, *watching, *slow):
        each.close()


def test_pages_that_only_watch_leave_room_for_the_operator(served):
    watching = []
    try:
        for _ in range(64):
            watching.append(watch(served))
        heads = [each.recv(12)[9:] for each in watching]
        most = page_server._MAX_WATCHING
        assert sorted(heads) == [b"200"] * most + [b"503"] * (64 - most)
        assert answer_of(served, "/?token=secret") == 200
        assert answer_of(served, "/panel") == 503
        operator = http.client.HTTPConnection(*served, timeout=20)
        operator.request("GET", "/panel?token=secret")
        answer = operator.getresponse()
        assert answer.status == 200
        assert answer.readline().startswith(b"data: ")
        operator.close()
    finally:
        for each in watching:
            each.close()


def frame(opcode, data, masked=True):
    """Return a WebSocket frame of a browser."""
    size, bit = len(data), 0x80 if masked else 0
    if size < 126:
        head = bytes([0x80 | opcode, bit | size])
    elif size < 1 << 16:
        head = bytes([0x80 | opcode, bit | 126]) + size.to_bytes(2, "big")
    else:
        head = bytes([0x80 | opcode, bit | 127]) + size.to_bytes(8, "big")
    return head + (b"\0\0\0\0" if masked else b"") + data


@given(
    st.lists(st.tuples(st.sampled_from([1, 2, 9, 10]), st.integers(0, 300))), st.data()
)
def test_control_frames_pass_whole_however_the_stream_is_cut(frames, data):
    frames = [(op, b"x" * (n if op < 8 else n % 126)) for op, n in frames]
    stream = b"".join(frame(op, body) for op, body in frames)
    kept = ControlFrames()
    passed = b""
    while stream:
        n = data.draw(st.integers(1, len(stream)))
        passed += kept.filter(stream[:n])
        stream = stream[n:]
    assert passed == b"".join(frame(op, body) for op, body in frames if op >= 8)


@pytest.mark.parametrize("first", [0x0B, 0x09, 0x8B, 0xC9, 0x82, 0x01])
def test_only_whole_control_frames_that_are_known_pass(first):
    kept = ControlFrames()
    odd = bytes([first]) + frame(9, b"a")[1:]
    assert kept.filter(odd + frame(9, b"b")) == frame(9, b"b")


def test_a_long_frame_is_dropped():
    kept = ControlFrames()
    assert kept.filter(frame(2, b"x" * 70_000) + frame(9, b"a")) == frame(9, b"a")


def test_a_control_frame_that_claims_to_be_long_is_dropped():
    # Nobody may fill the memory of the page's server with it.
    kept = ControlFrames()
    assert kept.filter(frame(9, b"x" * 70_000) + frame(9, b"a")) == frame(9, b"a")
    claim = b"\x89\xff" + (1 << 40).to_bytes(8, "big") + b"mask"
    assert kept.filter(claim) == b""
    for _ in range(3):
        assert kept.filter(b"x" * 1_000_000) == b""
    assert len(pickle.dumps(kept)) < 10_000


def test_the_panel_s_server_is_read_only(panel):
    parts = urlsplit(panel.url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    connection.request("POST", "/panel", body="{}")
    assert connection.getresponse().status == 501
    connection.close()


def test_a_server_that_stalls_gets_the_last_fields(panel):
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    servers = []
    for child in children:
        with contextlib.suppress(
            FileNotFoundError
        ):  # That of another test may have ended.
            if b"page_server" in Path(f"/proc/{child}/cmdline").read_bytes():
                servers.append(int(child))
    server = max(servers)
    for number in range(100):
        panel.say(f"message {number}, which is rather long: {'x' * 60}")
    os.kill(server, signal.SIGSTOP)
    try:
        for number in range(40):
            panel.show(mode=f"number {number}")
    finally:
        os.kill(server, signal.SIGCONT)
    deadline = time.monotonic() + 20
    mode = ""
    while mode != "the last" and time.monotonic() < deadline:
        panel.show(mode="the last")
        time.sleep(0.1)
        mode = next(told(panel)).get("mode")
    assert mode == "the last"


def test_closing_ends_the_server_and_the_connections(panel):
    events = told(panel)
    next(events)
    panel.close()
    list(events)
    with pytest.raises(ConnectionError):
        ask(panel, "/")
    panel.show(mode="nobody is told")


def test_server_ends_with_the_last_reference_to_its_panel():
    panel = PagePanel(Meshcat())
    url = urlsplit(panel.url)
    del panel
    with pytest.raises(ConnectionError):
        http.client.HTTPConnection(url.hostname, url.port, timeout=20).connect()


def test_the_simulation_s_process_has_no_threads_of_the_panel():
    # Where one collects garbage with a Meshcat in it, Drake ends the program.
    before = threading.active_count()
    panel = PagePanel(Meshcat())
    assert threading.active_count() == before
    panel.close()


def test_two_panels_have_addresses_of_their_own(panel):
    other = PagePanel(panel.meshcat)
    assert other.url != panel.url
    other.show(title="other")
    assert "title" not in panel.shown
    other.close()


def test_saved_page_contains_a_panel_with_the_given_text():
    page = add_panel(Meshcat().StaticHtml(), {"title": "run"})
    assert page.count("<title>") == 1
    assert "<title>run</title>" in page
    assert page.rstrip().endswith("</html>")


def test_panel_in_a_file_that_is_not_a_page_is_refused():
    with pytest.raises(SystemsError, match="a head and a body"):
        add_panel("<p>nothing</p>", {})


def test_a_host_at_which_nothing_can_be_served_is_refused():
    with pytest.raises(SystemsError, match=r"cannot be served at 192\.0\.2\.1"):
        PagePanel(Meshcat(), host="192.0.2.1")  # An address of nobody.


# In a notebook.


@pytest.mark.browser
@needs_chromium
def test_notebook_shows_the_page_of_meshcat(tmp_path):
    meshcat = Meshcat()
    meshcat.SetObject("box", Box(1.0, 1.0, 1.0), Rgba(1.0, 0.0, 0.0))
    meshcat.SetCameraPose([2.0, 0.0, 0.5], [0.0, 0.0, 0.0])
    shown = InlinePage(meshcat.StaticHtml(), height=300)
    page = tmp_path / "notebook.html"
    page.write_text(f"<body>{shown._repr_html_()}</body>", encoding="utf-8")
    red, green, _ = np.moveaxis(screenshot(page.as_uri(), tmp_path), 2, 0)
    assert np.mean((red > 0.3) & (green < 0.2 * red)) > 0.02


def test_inline_page_shows_its_size_as_text():
    assert repr(InlinePage("x" * 2_340_000)) == "InlinePage of 2.3 MB"


def test_a_meshcat_in_place_of_its_page_is_refused():
    with pytest.raises(SystemsError, match=r"html is .*; its type must be str"):
        InlinePage(Meshcat())


def test_server_without_its_program_prints_nothing():
    server = subprocess.Popen(
        [sys.executable, page_server.__file__, hidden_meshcat().web_url(), "localhost"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    server.stdout.close()
    server.stdin.write("token\n")
    server.stdin.close()
    assert server.stderr.read() == ""
    server.stderr.close()
    assert server.wait(60) == 1
