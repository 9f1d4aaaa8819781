"""The live page: requests, who may look and operate, and the state of the legs."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveFault
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.app.run_description import run_description
from hil.app.watch.access import Access
from hil.app.watch.feed import Feed
from hil.app.watch.http import BODY_BYTES, HEAD_BYTES, Refused, Request, read_request, refusal
from hil.app.watch.operating import WORDS, line_of
from hil.app.watch.server import MOST_COMMANDS, Server, Watcher
from hil.app.watch.state import state
from hil.record.mirror import FIGURES, Piece

TOKEN = "s3cret"
LOCAL = Access(TOKEN, 8642, frozenset({"127.0.0.1", "localhost", "::1"}), beyond=False, operate=True)
BEYOND = Access(TOKEN, 8642, frozenset({"robot"}), beyond=True, operate=True)
HOST = "127.0.0.1:8642"


def read(data, *, ends=True):
    async def feed():
        reader = asyncio.StreamReader(limit=HEAD_BYTES)
        reader.feed_data(data)
        if ends:
            reader.feed_eof()
        return await read_request(reader)

    return asyncio.run(feed())


def request(path="/", method="GET", cookie=None, query=None, **headers):
    given = {"host": HOST, **{name.replace("_", "-"): value for name, value in headers.items()}}
    if cookie is not None:
        given["cookie"] = f"other=1; hil-watch-8642={cookie}"
    return Request(method, path, query or {}, {k: v for k, v in given.items() if v is not None}, b"")


def status_of(check, *arguments):
    try:
        check(*arguments)
    except Refused as refused:
        return refused.status
    return HTTPStatus.OK


def test_a_request_is_read_with_its_body_and_no_more():
    data = b"POST /operate?a=1&a=%3d HTTP/1.1\r\nHost: x\r\nContent-Length: 3\r\n\r\nabcGET"
    found = read(data)
    assert found is not None
    assert (found.method, found.path, found.query, found.body) == ("POST", "/operate", {"a": "="}, b"abc")
    assert found.headers == {"host": "x", "content-length": "3"}
    assert read(b"") is None


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET /\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/2\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET http://evil/ HTTP/1.1\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"TRACE / HTTP/1.1\r\n\r\n", HTTPStatus.METHOD_NOT_ALLOWED),
        (b"GET / HTTP/1.1\r\nHost x\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/1.1\r\nHost : x\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/1.1\r\nHost: a\r\nhost: b\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/1.1\r\nX: a\nb\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET / HTTP/1.1\r\nHost: x", HTTPStatus.BAD_REQUEST),
        (b"GET /?" + b"&".join([b"a=1"] * 9) + b" HTTP/1.1\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"GET /" + b"a" * HEAD_BYTES + b" HTTP/1.1\r\n\r\n", HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE),
        (b"a" * (2 * HEAD_BYTES), HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE),
        (b"POST / HTTP/1.1\r\nContent-Length: 9\r\n\r\nshort", HTTPStatus.BAD_REQUEST),
        (b"POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"POST / HTTP/1.1\r\nContent-Length: 1_0\r\n\r\n", HTTPStatus.BAD_REQUEST),
        (b"POST / HTTP/1.1\r\nContent-Length: 99999999999999999999\r\n\r\n", HTTPStatus.REQUEST_ENTITY_TOO_LARGE),
        (b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % (BODY_BYTES + 1), HTTPStatus.REQUEST_ENTITY_TOO_LARGE),
        (b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", HTTPStatus.BAD_REQUEST),
    ],
)  # fmt: skip
def test_a_malformed_or_too_large_request_is_refused(data, status):
    with pytest.raises(Refused) as refused:
        read(data)
    assert refused.value.status is status
    answer = refusal(refused.value)
    assert answer.startswith(f"HTTP/1.1 {status.value} ".encode())
    assert b"\r\nConnection: close\r\n" in answer


def test_a_request_that_never_ends_is_given_up(monkeypatch):
    monkeypatch.setattr("hil.app.watch.http.PATIENCE_S", 0.05)
    with pytest.raises(Refused) as refused:
        read(b"GET / HTTP/1.1\r\n", ends=False)
    assert refused.value.status is HTTPStatus.REQUEST_TIMEOUT


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
def test_the_loopback_is_for_its_own_page_alone(given, status):
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
def test_beyond_the_loopback_all_need_the_token(given, status):
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
def test_who_operates_has_the_token_and_the_page(given, status):
    assert status_of(LOCAL.check_operate, given) is status
    closed = Access(TOKEN, 8642, LOCAL.names, beyond=False, operate=False)
    assert status_of(closed.check_operate, given) is not HTTPStatus.OK, "the configuration decides first"


def test_the_words_of_the_page_are_passed_on_and_no_others():
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


class Deaf:
    """A controller that answers nothing until it is `free`, but for the emergency stop."""

    def __init__(self):
        self.stops = 0
        self.asked, self.free = threading.Semaphore(0), threading.Event()

    def say(self, line):
        if line == "estop":
            self.stops += 1
        else:
            self.status()
        return True, ""

    def status(self):
        self.asked.release()
        self.free.wait()


def operate(line):
    return request("/operate", "POST", TOKEN, **GOOD)._replace(body=b'{"line": "%s"}' % line.encode())


def test_an_emergency_stop_passes_where_other_commands_wait(tmp_path):
    """Eight commands and a question for the state wait; further ones get 503, but each emergency stop is passed on."""
    deaf, watcher = Deaf(), Watcher(object())  # type: ignore[arg-type]
    server = Server(Feed(tmp_path / "none"), LOCAL, {}, deaf)
    server._watchers[watcher] = None

    async def scene(elsewhere):
        loop = asyncio.get_running_loop()
        asking = asyncio.create_task(server._ask(deaf.status))
        waiting = [asyncio.create_task(server._operate(operate("hold"))) for _ in range(MOST_COMMANDS)]
        for _ in range(MOST_COMMANDS + 1):
            await loop.run_in_executor(elsewhere, deaf.asked.acquire)
        try:
            for line in ("hold", "stop", "key"):
                with pytest.raises(Refused) as refused:
                    await server._operate(operate(line))
                assert refused.value.status is HTTPStatus.SERVICE_UNAVAILABLE
            for count in (1, 2, 3):
                async with asyncio.timeout(10.0):
                    answer = await server._operate(operate("estop"))
                assert b'{"taken": true, "why": ""}' in answer
                assert deaf.stops == count
            assert not any(task.done() for task in waiting)
        finally:
            deaf.free.set()
            asking.cancel()
        assert len(await asyncio.gather(*waiting)) == MOST_COMMANDS
        assert b'"taken": true' in await server._operate(operate("hold")), "there is room again"

    with ThreadPoolExecutor(1) as elsewhere:
        asyncio.run(scene(elsewhere))


ABOUT = run_description(load("virtual"), Path("runs/x.mcap"), 1000.0, 20.0)
SHORTEST, LONGEST, SILENT = 0.75, 2.2, 5
"""m, the ends of the stroke, and the ticks from which a leg is silent, in configs/virtual.yaml."""


def legs_of(**columns):
    """Return what is shown of the legs of a row."""
    row = np.zeros((), ROW)
    for name, value in columns.items():
        row[name] = value
    there: Any = row[()]
    figures: Any = np.zeros((), FIGURES)[()]
    return state(Piece(1, there, figures, []), ABOUT, 0)["legs"]


def test_the_margin_of_a_leg_is_the_way_to_the_nearer_of_its_two_ends():
    low, high = SHORTEST + 0.01, LONGEST - 0.02
    found = legs_of(q=[low, high, 0.5 * (SHORTEST + LONGEST), SHORTEST - 0.003, LONGEST + 0.004, high])
    assert found["margin"] == pytest.approx([10.0, 20.0, 725.0, -3.0, -4.0, 20.0], abs=0.01)


@pytest.mark.parametrize("leg", range(6))
def test_the_mark_of_each_leg_says_all_that_is_wrong_with_it(leg):
    age, fault = np.zeros(6, int), np.zeros(6, int)
    age[leg], fault[leg] = 200, DriveFault.OVERFORCE
    found = legs_of(
        age=age, drive_fault=fault, legs_doubted=1 << leg, legs_moved=1 << leg, legs_refused=1 << leg
    )["marked"]
    said = set(found.pop(leg).split(", "))
    assert said == {"encoder doubted", "moved on its brake", "drive refuses", "silent", "overforce"}
    assert found == [""] * 5
