"""Facts about the panel of the page, without a browser."""

import http.client
import json
import threading
from urllib.parse import urlsplit

import pytest
from pydrake.geometry import Meshcat

from fmp_drake.errors import SystemsError
from fmp_drake.systems.viewer.page_panel import PagePanel, add_panel


@pytest.fixture
def panel():
    panel = PagePanel(Meshcat())
    yield panel
    panel.close()


def ask(panel, path):
    """Return status, type and text of an answer of the page's server."""
    parts = urlsplit(panel.url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    connection.request("GET", path)
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


def test_what_the_page_needs_besides_comes_from_meshcat(panel):
    _, _, page = ask(panel, "/")
    script = page.split('src="cas-v1/')[1].split('"')[0]
    status, _, text = ask(panel, f"/cas-v1/{script}")
    assert status == 200
    assert "gui_controllers" in text
    assert ask(panel, "/nothing")[0] == 404


def test_a_browser_is_told_what_is_shown_and_what_changes(panel):
    panel.show(mode="wiping", time=1.0)
    events = told(panel)
    first = {"mode": "wiping", "time": 1.0}
    assert first in (next(events), next(events))
    panel.show(time=2.0)
    assert next(events) == {"mode": "wiping", "time": 2.0}
    events.close()


def test_nobody_can_change_anything_through_the_panel_s_server(panel):
    parts = urlsplit(panel.url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    connection.request("POST", "/panel", body="{}")
    assert connection.getresponse().status == 501
    connection.close()


def test_closing_ends_the_server_and_lets_browsers_go(panel):
    events = told(panel)
    next(events)
    panel.close()
    list(events)
    with pytest.raises(ConnectionError):
        ask(panel, "/")
    panel.show(mode="nobody is told")


def test_a_panel_that_nobody_keeps_ends_its_server():
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


def test_a_saved_page_gets_a_panel_that_says_what_it_is_given():
    page = add_panel(Meshcat().StaticHtml(), {"title": "run"})
    assert page.count("<title>") == 1
    assert "<title>run</title>" in page
    assert page.rstrip().endswith("</html>")


def test_a_panel_in_what_is_no_page_is_refused():
    with pytest.raises(SystemsError, match="a head and a body"):
        add_panel("<p>nothing</p>", {})


def test_a_host_at_which_nothing_can_be_served_is_refused():
    with pytest.raises(SystemsError, match=r"cannot be served at 192\.0\.2\.1"):
        PagePanel(Meshcat(), host="192.0.2.1")  # An address of nobody.
