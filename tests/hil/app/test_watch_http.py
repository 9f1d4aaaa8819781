"""The live page: requests, rights to view and to operate, and the state of the legs."""

from __future__ import annotations

import socket
import threading
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveFault
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.app.watch.access import Access, Refused, Request
from hil.app.watch.feed import Feed
from hil.app.watch.server import MOST_COMMANDS, WORDS, Server, line_of
from hil.app.watch.state import run_description, state
from hil.record.mirror import FIGURES, Piece

TOKEN = "s3cret"
LOCAL = Access(TOKEN, 8642, frozenset({"127.0.0.1", "localhost", "::1"}), beyond=False, operate=True)
BEYOND = Access(TOKEN, 8642, frozenset({"robot"}), beyond=True, operate=True)
HOST = "127.0.0.1:8642"


def request(path="/", method="GET", cookie=None, query=None, **headers):
    given = {"host": HOST, **{name.replace("_", "-"): value for name, value in headers.items()}}
    if cookie is not None:
        given["cookie"] = f"other=1; hil-watch-8642={cookie}"
    return Request(method, path, query or {}, {k: v for k, v in given.items() if v is not None})


def status_of(check, *arguments):
    try:
        check(*arguments)
    except Refused as refused:
        return refused.status
    return HTTPStatus.OK


class Deaf:
    """A controller that answers only the emergency stop until it is `free`."""

    def __init__(self):
        self.stops = 0
        self.asked, self.free = threading.Semaphore(0), threading.Event()

    def say(self, line):
        if line == "estop":
            self.stops += 1
        else:
            self.asked.release()
            self.free.wait()
        return True, ""

    def status(self):
        return None


@pytest.fixture
def deaf():
    found = Deaf()
    yield found
    found.free.set()


@pytest.fixture
def port(tmp_path, deaf):
    """A server of one page in a thread of this process."""
    listening = socket.create_server(("127.0.0.1", 0))
    port = listening.getsockname()[1]
    access = replace(LOCAL, port=port)
    with Server(listening, Feed(tmp_path / "none"), access, {"/": (b"page", "text/html")}, deaf) as server:
        serving = threading.Thread(target=server.serve_forever, args=(0.01,))
        serving.start()
        yield port
        server.shutdown()
        serving.join()


def opened(port, data):
    connection = socket.create_connection(("127.0.0.1", port), timeout=10.0)
    connection.sendall(data.replace(b"HOST", b"Host: 127.0.0.1:%d\r\n" % port))
    return connection


def answered(connection):
    """The whole answer and its status; 0 if the connection is closed without an answer."""
    with connection, connection.makefile("rb") as file:
        found = file.read()
    return found, int(found[9:12] or 0)


def test_connection_serves_one_request_and_closes(port):
    found, status = answered(opened(port, b"GET /?a=1&a=%3d HTTP/1.1\r\nHOST\r\nGET / HTTP/1.1\r\nHOST\r\n"))
    assert status == HTTPStatus.OK
    assert found.count(b"page") == 1
    assert b"\r\nConnection: close\r\n" in found
    found, status = answered(opened(port, b"HEAD / HTTP/1.1\r\nHOST\r\n"))
    assert (status, found[-4:]) == (HTTPStatus.OK, b"\r\n\r\n")


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/2\r\nHOST\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET http://evil/ HTTP/1.1\r\nHOST\r\n", HTTPStatus.NOT_FOUND),
        (b"TRACE / HTTP/1.1\r\nHOST\r\n", HTTPStatus.NOT_IMPLEMENTED),
        (b"GET / HTTP/1.1\r\n\r\n", HTTPStatus.FORBIDDEN),
        (b"GET / HTTP/1.1\r\nHost x\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/1.1\r\nHost: evil\r\nHOST\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/1.1\r\nHOSTX: a\nb\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/1.1\r\nHOSTX: " + b"a" * 8192 + b"\r\n\r\n", HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE),
        (b"GET /?" + b"&".join([b"a=1"] * 9) + b" HTTP/1.1\r\nHOST\r\n", HTTPStatus.BAD_REQUEST),
        (b"POST / HTTP/1.1\r\nHOSTContent-Length: 1\r\n\r\n1", HTTPStatus.UNAUTHORIZED),
    ],
)  # fmt: skip
def test_malformed_or_too_large_request_is_refused(data, status, port):
    found, given = answered(opened(port, data))
    assert given == status
    assert b"\r\nConnection: close\r\n" in found
    assert not found.endswith(b"page")


def test_incomplete_request_times_out(port, monkeypatch):
    monkeypatch.setattr("hil.app.watch.server.REQUEST_S", 0.1)
    assert answered(opened(port, b"GET / HTTP/1.1\r\n"))[1] == 0
    assert answered(opened(port, b"GET / HTTP/1.1\r\nHOST\r\n"))[1] == HTTPStatus.OK


def test_watch_server_closes_the_oldest_idle_connections_when_new_ones_exceed_the_maximum(port, monkeypatch):
    monkeypatch.setattr("hil.app.watch.server.MOST_CONNECTIONS", 3)
    waiting = [opened(port, b"GET") for _ in range(4)]
    assert answered(opened(port, b"GET / HTTP/1.1\r\nHOST\r\n"))[1] == HTTPStatus.OK
    assert [answered(each)[1] for each in waiting[:2]] == [0, 0]
    for each in waiting[2:]:
        each.close()


def test_watch_server_closes_the_oldest_page_for_a_new_one_with_the_token(port, monkeypatch):
    def stream(cookie=b""):
        connection = opened(port, b"GET /stream HTTP/1.1\r\n%sHOST\r\n" % cookie)
        return connection, connection.recv(17)[9:12]

    monkeypatch.setattr("hil.app.watch.server.MOST_STREAMS", 2)
    token = b"Cookie: hil-watch-%d=%s\r\n" % (port, TOKEN.encode())
    streams = [stream(), stream(token), stream(), stream(token), stream(token)]
    assert [status for _, status in streams] == [b"200", b"200", b"503", b"200", b"200"]
    for k in (0, 1):  # the one without it, then the oldest
        while streams[k][0].recv(4096):
            pass  # until it is closed
    for connection, _ in streams:
        connection.close()


@pytest.mark.parametrize(
    ("given", "status"),
    [
        (request(), HTTPStatus.OK),
        (request(host="localhost:8642"), HTTPStatus.OK),
        (request(host="[::1]:8642"), HTTPStatus.OK),
        (request(host="evil.example:8642"), HTTPStatus.FORBIDDEN),
        (request(host="127.0.0.1:80"), HTTPStatus.FORBIDDEN),
        (request(host="127.0.0.1"), HTTPStatus.FORBIDDEN),
        (request(host="192.168.0.7:8642"), HTTPStatus.FORBIDDEN),
        (request(host=""), HTTPStatus.FORBIDDEN),
        (request(origin=f"http://{HOST}"), HTTPStatus.OK),
        (request(origin="http://evil.example"), HTTPStatus.FORBIDDEN),
        (request(origin="http://127.0.0.1:9999"), HTTPStatus.FORBIDDEN),
        (request(origin="null"), HTTPStatus.FORBIDDEN),
        (request(sec_fetch_site="cross-site", sec_fetch_mode="no-cors"), HTTPStatus.FORBIDDEN),
        (request(sec_fetch_site="same-site", sec_fetch_mode="cors"), HTTPStatus.FORBIDDEN),
        (request(sec_fetch_site="cross-site", sec_fetch_mode="navigate"), HTTPStatus.OK),
        (request(sec_fetch_site="same-origin", sec_fetch_mode="cors"), HTTPStatus.OK),
    ],
)
def test_loopback_serves_only_requests_of_its_own_page(given, status):
    assert status_of(LOCAL.check, given) is status


@pytest.mark.parametrize(
    ("given", "status"),
    [
        (request(host="robot:8642"), HTTPStatus.UNAUTHORIZED),
        (request(host="robot:8642", cookie="wrong"), HTTPStatus.UNAUTHORIZED),
        (request(host="robot:8642", cookie=""), HTTPStatus.UNAUTHORIZED),
        (request(host="robot:8642", cookie="s3cré"), HTTPStatus.UNAUTHORIZED),
        (request(host="robot:8642", cookie=TOKEN), HTTPStatus.OK),
        (request(host="robot:8642", query={"token": TOKEN}), HTTPStatus.OK),
        (request("/stream", host="robot:8642", query={"token": TOKEN}), HTTPStatus.UNAUTHORIZED),
        (request(host="192.168.0.7:8642", cookie=TOKEN), HTTPStatus.OK),
        (request(host="evil.example:8642", cookie=TOKEN), HTTPStatus.FORBIDDEN),
    ],
)
def test_beyond_the_loopback_every_request_needs_the_token(given, status):
    assert status_of(BEYOND.check, given) is status


GOOD = {"origin": f"http://{HOST}", "content_type": "application/json"}


@pytest.mark.parametrize(
    ("given", "status"),
    [
        (request("/operate", "POST", TOKEN, **GOOD), HTTPStatus.OK),
        (request("/operate", "POST", **GOOD), HTTPStatus.UNAUTHORIZED),
        (request("/operate", "POST", "wrong", **GOOD), HTTPStatus.UNAUTHORIZED),
        (request("/operate", "POST", query={"token": TOKEN}, **GOOD), HTTPStatus.UNAUTHORIZED),
        (request("/operate", "POST", TOKEN, content_type="application/json"), HTTPStatus.FORBIDDEN),
        (request("/operate", "POST", TOKEN, origin=f"http://{HOST}"), HTTPStatus.FORBIDDEN),
        (request("/operate", "POST", TOKEN, **{**GOOD, "content_type": "text/plain"}), HTTPStatus.FORBIDDEN),
        (request("/operate", "POST", TOKEN, **{**GOOD, "origin": "http://evil"}), HTTPStatus.FORBIDDEN),
        (request("/operate", "POST", TOKEN, host="evil:8642", **GOOD), HTTPStatus.FORBIDDEN),
    ],
)
def test_request_to_operate_needs_the_token_and_the_origin_of_the_page(given, status):
    assert status_of(LOCAL.check_operate, given) is status
    closed = Access(TOKEN, 8642, LOCAL.names, beyond=False, operate=False)
    assert status_of(closed.check_operate, given) is not HTTPStatus.OK, "watch.operate is false"


def test_watch_server_forwards_only_the_commands_of_its_page():
    for line in (
        "arm",
        "start",
        "hold",
        "stop",
        "park",
        "reset",
        "estop",
        "key",
        "speed 40",
        "jog leg3 -0.5",
    ):
        assert line_of(b'{"line": "%s"}' % line.encode()) == line
        assert line.split()[0] in WORDS
    for body in (
        b"", b"[]", b'"hold"', b'{"line": 3}', b'{"line": ""}', b'{"line": "hold", "x": 1}', b"{" * 500, b"\xff",
        b'{"line": "release"}', b'{"line": "setpoint 0 0 1"}', b'{"line": "end"}', b'{"line": "status"}',
        b'{"line": "#1 estop"}', b'{"line": "speed 101"}', b'{"line": "speed nan"}', b'{"line": "jog x 2"}',
        b'{"line": "hold\\nestop"}', b'{"line": "hold now"}',
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"."):
            line_of(body)


def operate(port, line, length=None):
    body = b'{"line": "%s"}' % line
    return opened(
        port,
        b"POST /operate HTTP/1.1\r\nOrigin: http://127.0.0.1:%d\r\nContent-Type: application/json\r\n"
        b"Cookie: other=\xe9; hil-watch-%d=%s\r\nContent-Length: %s\r\nHOST\r\n%s"
        % (port, port, TOKEN.encode(), length or b"%d" % len(body), body),
    )


@pytest.mark.parametrize("length", [b"-1", b"1_0", b"513", b"9" * 20, b""])
def test_command_of_invalid_or_excessive_length_is_refused(length, port, deaf):
    assert answered(operate(port, b"estop", b" " + length))[1] == HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    assert deaf.stops == 0


def test_emergency_stop_passes_while_other_commands_wait(port, deaf):
    """Eight commands wait; further ones get 503, but every emergency stop is forwarded."""
    waiting = [operate(port, b"hold") for _ in range(MOST_COMMANDS)]
    for _ in range(MOST_COMMANDS):
        deaf.asked.acquire()
    for line in (b"hold", b"stop", b"key"):
        assert answered(operate(port, line))[1] == HTTPStatus.SERVICE_UNAVAILABLE
    for count in (1, 2, 3):
        assert b'{"taken": true, "why": ""}' in answered(operate(port, b"estop"))[0]
        assert deaf.stops == count
    deaf.free.set()
    assert all(b'"taken": true' in answered(each)[0] for each in waiting)
    assert b'"taken": true' in answered(operate(port, b"hold"))[0], "the command queue has room again"


ABOUT = run_description(load("virtual"), Path("runs/x.mcap"), 1000.0, 20.0)
SHORTEST, LONGEST, SILENT = 0.75, 2.2, 5
"""Ends of the stroke, m, and ticks after which a leg is silent, in configs/virtual.yaml."""


def legs_of(about=ABOUT, **columns):
    """Part of the state that shows the legs, for a row."""
    row = np.zeros((), ROW)
    for name, value in columns.items():
        row[name] = value
    there: Any = row[()]
    figures: Any = np.zeros((), FIGURES)[()]
    return state(Piece(1, False, there, figures, []), about, 0)["legs"]


def test_live_page_shows_the_distance_of_a_leg_to_its_nearer_end_in_mm():
    low, high = SHORTEST + 0.01, LONGEST - 0.02
    found = legs_of(q=[low, high, 0.5 * (SHORTEST + LONGEST), SHORTEST - 0.003, LONGEST + 0.004, high])
    assert found["margin"] == pytest.approx([10.0, 20.0, 725.0, -3.0, -4.0, 20.0], abs=0.01)


@pytest.mark.parametrize("leg", range(6))
def test_live_page_lists_all_problems_of_a_marked_leg(leg):
    age, fault = np.zeros(6, int), np.zeros(6, int)
    age[leg], fault[leg] = 200, DriveFault.OVERFORCE
    found = legs_of(
        age=age, drive_fault=fault, legs_doubted=1 << leg, legs_moved=1 << leg, legs_refused=1 << leg
    )["marked"]
    said = set(found.pop(leg).split(", "))
    assert said == {"encoder doubted", "moved on its brake", "drive refuses", "silent", "overforce"}
    assert found == [""] * 5


@pytest.mark.parametrize(("name", "reported"), [("virtual", 7.5), ("vcan50", None)])
def test_live_page_shows_no_reported_force_of_a_drive_that_reports_none(name, reported):
    c = load(name)
    assert (c.bus.layout == "classic") is (reported is None)
    about = run_description(c, Path("runs/x.mcap"), c.loop.rate_Hz, 20.0)
    assert legs_of(about, drive_force=7.5)["given"] == [reported] * 6
