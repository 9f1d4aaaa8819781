"""The server of the live page: viewers, hostile connections, and the token."""

from __future__ import annotations

import http.client
import json
import socket
import time

import numpy as np
import pytest

from drivers.tick_columns import ROW
from tests.live_run import Listening, LiveRun, Watch

pytestmark = pytest.mark.usefixtures("meeting_place")
ASSETS = (
    "/", "/page.css", "/watch.js", "/charts.js", "/operate.js", "/history.js", "/scene.js", "/uPlot.iife.min.js", "/uPlot.min.css",
    "/stream",
)  # fmt: skip


@pytest.fixture
def rows():
    found = np.zeros(3000, ROW)
    found["tick"] = np.arange(3000)
    found["R"] = np.eye(3)
    return found


def ask(watch, method, path, body=None, **headers):
    """Status, headers and body of one request."""
    connection = http.client.HTTPConnection("127.0.0.1", watch.port, timeout=10.0)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    found = answer.status, dict(answer.getheaders()), b"" if path == "/stream" else answer.read()
    connection.close()
    return found


def opened(watch, data):
    connection = socket.create_connection(("127.0.0.1", watch.port), timeout=10.0)
    connection.sendall(data)
    return connection


STREAM = b"GET /stream HTTP/1.1\r\nHost: localhost:%d\r\n\r\n"


class Reading:
    """Client of a stream."""

    def __init__(self, watch):
        self._socket = opened(watch, STREAM % watch.port)
        self.text = b""

    def read(self, seconds, states=0):
        """Read for a time, or until a number of states have arrived."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not 0 < states <= self.text.count(b"event: state\n"):
            self._socket.settimeout(max(0.01, end - time.monotonic()))
            try:
                data = self._socket.recv(1 << 20)
            except TimeoutError:
                break
            assert data, "the server has closed a watcher that reads"
            self.text += data

    def states(self):
        lines = self.text.decode().split("\n\n")[:-1]
        return [json.loads(each.partition("data: ")[2]) for each in lines if "event: state\n" in each]

    def close(self):
        self._socket.close()


def test_viewer_receives_the_run_and_its_events(rows, watch):
    with LiveRun(rows, name="first"):
        watcher = Reading(watch)
        watcher.read(5.0, states=40)
        text = watcher.text.decode()
        assert '"name":"first"' in text
        assert '"columns"' not in text
        events = json.loads(text.partition("event: events\ndata: [{")[2].partition("\n")[0].join(("[{", "")))
        assert events[0] == {"t": 0.005, "level": "info", "text": "<b>begun</b>"}
        assert events[1]["text"] == "it broke"
        states = watcher.states()
        ticks = [each["tick"] for each in states]
        assert len(states) > 20
        assert ticks == sorted(ticks)
        assert ticks[-1] - ticks[0] > 300
        assert all(abs(each["age"]) < 0.5 for each in states)
        watcher.close()


def test_ten_viewers_receive_the_run_despite_hostile_connections(rows, watch):
    with LiveRun(rows):
        first = Reading(watch)
        first.read(1.0, states=1)
        before = watch.resident_kB
        others = [Reading(watch) for _ in range(9)]
        silent = opened(watch, STREAM % watch.port)
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        idle = []
        for k in range(100):
            idle.append(
                opened(
                    watch,
                    (b"", b"GET", b"\0" * 3000, b"POST / HTTP/1.1\r\nContent-Length: 400\r\n\r\n")[k % 4],
                )
            )
        bad = [opened(watch, b"\xff\xfe" * 5000 + b"\r\n\r\n") for _ in range(20)]
        first.text = b""
        first.read(1.5)
        assert len(first.states()) > 30, "50 Hz, or what a busy machine leaves of it"
        for each in others:
            each.read(1.0, states=1)
            assert each.states(), "each of the ten is served"
        assert watch.resident_kB - before < 20_000, "the server buffers nothing for viewers that do not read"
        for each in (*others, *idle, *bad, silent, first):
            each.close()
        assert ask(watch, "GET", "/")[0] == 200


def post(watch, line, **headers):
    given = {
        "Origin": watch.base,
        "Content_Type": "application/json",
        "Cookie": f"hil-watch-{watch.port}={watch.token}",
    }
    given |= headers
    body = json.dumps({"line": line})
    return ask(watch, "POST", "/operate", body, **{name: value for name, value in given.items() if value})


def test_no_command_reaches_the_controller_without_the_token(rows, operated):
    with LiveRun(rows), Listening() as controller:
        assert len(operated.token) >= 32
        for headers in (
            {"Cookie": ""}, {"Cookie": f"hil-watch-{operated.port}=guess"}, {"Origin": ""},
            {"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Content_Type": "text/plain"},
        ):  # fmt: skip
            assert post(operated, "estop", **headers)[0] in {401, 403}
        assert ask(operated, "GET", f"/operate?token={operated.token}&line=estop")[0] == 404
        assert post(operated, "release")[0] == 400
        assert controller.lines == []
        status, _, body = post(operated, "hold")
        assert (status, json.loads(body)) == (200, {"taken": True, "why": ""})
        assert controller.lines == ["hold"]


def test_command_from_the_live_page_is_refused_unless_watch_operate_is_configured(rows, watch):
    with LiveRun(rows), Listening() as controller:
        assert len(watch.token) >= 32, "the token protects the connection of a viewer: it must be long"
        assert post(watch, "hold")[0] == 403
        assert controller.lines == []


def test_command_from_the_live_page_is_answered_with_the_reason_if_no_controller_runs(rows, operated):
    with LiveRun(rows):
        status, _, body = post(operated, "hold")
        assert status == 200
        assert json.loads(body)["taken"] is False
        assert "no controller runs on bus localcan:hil0" in json.loads(body)["why"]


def test_link_with_the_token_sets_the_cookie_and_the_content_security_policy(rows, operated):
    with LiveRun(rows):
        status, headers, _ = ask(operated, "GET", f"/?token={operated.token}")
        assert status == 200
        assert (
            headers["Set-Cookie"]
            == f"hil-watch-{operated.port}={operated.token}; HttpOnly; SameSite=Strict; Path=/"
        )
        assert headers["Content-Security-Policy"].startswith("default-src 'none'; script-src 'self'; ")
        assert "unsafe" not in headers["Content-Security-Policy"]
        assert "Set-Cookie" not in ask(operated, "GET", "/?token=wrong")[1]
        status, headers, body = ask(operated, "HEAD", "/")
        assert (status, body) == (200, b"")
        assert int(headers["Content-Length"]) > 1000
        assert ask(operated, "GET", "/../operated.html")[0] == 404
        assert ask(operated, "POST", "/")[0] == 401


def test_beyond_the_loopback_no_page_is_served_without_the_token(rows):
    with Watch("virtual", "--host", "0.0.0.0") as watch, LiveRun(rows):
        cookie = f"hil-watch-{watch.port}={watch.token}"
        for path in ASSETS:
            assert ask(watch, "GET", path)[0] == 401, path
            assert ask(watch, "GET", path, Cookie=cookie)[0] == 200, path
        assert ask(watch, "GET", f"/?token={watch.token}")[0] == 200
