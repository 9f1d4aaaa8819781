"""Server of the live page, with bounds on every resource that clients use.

A connection has one request and its own thread, so that no client waits for another. A viewer that reads too
slowly misses ticks, and is disconnected after a while.
"""

import contextlib
import io
import json
import re
import select
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from socketserver import TCPServer, ThreadingMixIn
from typing import Any, NoReturn
from urllib.parse import parse_qs

from drivers.errors import HilError
from hil.app.watch.access import Access, Refused, Request
from hil.app.watch.feed import PERIOD_S, Feed, event
from hil.app.watch.history import History
from hil.operate.client import OperatorClient
from hil.operate.commands import parse

REQUEST_BYTES = 8192
"""Largest request, with its body."""
BODY_BYTES = 512
REQUEST_S = 10.0
"""Timeout of a whole request, from the opening of the connection."""
MOST_CONNECTIONS = 160
MOST_STREAMS = 24
MOST_COMMANDS = 8
"""Most commands in progress, besides emergency stops."""
BEHIND_BYTES = 32768
"""Unread bytes after which a viewer misses ticks."""
PATIENCE_S = 15.0
"""Timeout of a viewer that reads nothing."""
STATUS_S = 0.25
ESTOP = "estop"
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}


_SANDBOX = {"Content-Security-Policy": "sandbox allow-scripts allow-downloads; frame-ancestors 'none'"}
"""A report has a policy of its own, and here an origin of its own: no script of a log can operate."""
WORDS = frozenset({"arm", "start", "hold", "stop", "park", "reset", "estop", "speed", "jog", "key"})
"""Operator commands with controls on the page."""
KEY = "key"


def line_of(body: bytes) -> str:
    """Operator command of a request `{"line": "speed 40"}`, with single spaces between its words.

    Raises ValueError for any other request.
    """
    found = json.loads(body)
    if not isinstance(found, dict) or set(found) != {"line"} or not isinstance(found["line"], str):
        raise ValueError('allowed: {"line": "word [numbers]"}')
    line: str = found["line"]
    words = line.split()
    if not line.isprintable() or not words or words[0] not in WORDS:
        raise ValueError(f"allowed words: {', '.join(sorted(WORDS))}")
    parse(line)
    return " ".join(words)


class Operating:
    """Sends operator commands to the controller on a bus, each over its own connection."""

    def __init__(self, interface: str, channel: str) -> None:
        self._bus = interface, channel

    def say(self, line: str) -> tuple[bool, str]:
        """Send an operator command; return (accepted, reason of a refusal)."""
        try:
            with OperatorClient(*self._bus) as client:
                if line == KEY:
                    client.key()
                    return True, ""
                answer = client.say(line)
        except HilError as error:
            return False, str(error)
        return answer.taken, answer.why

    def status(self) -> dict[str, Any] | None:
        """Status of the controller; None if it does not answer."""
        try:
            with OperatorClient(*self._bus) as client:
                return client.status()
        except (HilError, ValueError):
            return None


class Server(ThreadingMixIn, TCPServer):
    """Serves the live page on a socket. Mutable state: connections, streams, commands in progress."""

    daemon_threads = True
    block_on_close = False

    def __init__(
        self,
        listening: socket.socket,
        feed: Feed,
        access: Access,
        assets: dict[str, tuple[bytes, str]],
        operating: Operating | None,
        history: History | None = None,
    ) -> None:
        super().__init__(("", 0), Handler, bind_and_activate=False)
        self.socket.close()
        self.socket = listening
        self.feed, self.access, self.assets, self.operating = feed, access, assets, operating
        self.history = history
        self.lock = threading.Lock()
        """Guards the feed, connections and streams."""
        self.waits: dict[socket.socket, bool] = {}
        """Connections, the oldest first: True while the request is incomplete."""
        self._streams: dict[socket.socket, bool] = {}
        """Streams, the oldest first: True if opened with the token."""
        self.commands = threading.BoundedSemaphore(MOST_COMMANDS)
        self.served = 0
        """Number of streams opened."""
        if operating is not None:
            threading.Thread(target=self._ask, args=(operating,), daemon=True).start()

    def _ask(self, operating: Operating) -> None:
        while True:
            if self._streams:
                self.feed.said = operating.status()
            time.sleep(STATUS_S)

    def verify_request(self, request: Any, client_address: Any) -> bool:  # noqa: ARG002 - of the base class
        """Accept a connection; at the limit close the oldest one whose request is incomplete."""
        with self.lock:
            if len(self.waits) >= MOST_CONNECTIONS:
                first = next((each for each, waits in self.waits.items() if waits), None)
                if first is None:
                    return False
                _end(first)
                del self.waits[first]
            self.waits[request] = True
        return True

    def shutdown_request(self, request: Any) -> None:
        """Close a connection and free its place."""
        with self.lock:
            self.waits.pop(request, None)
            super().shutdown_request(request)

    @contextmanager
    def stream(self, connection: socket.socket, *, ours: bool) -> Iterator[None]:
        """Reserve a place for a viewer's stream; at the limit, a stream with the token replaces the oldest.

        ours: it has the token. Streams without the token are closed first. Raises Refused without a place.
        """
        with self.lock:
            if len(self._streams) >= MOST_STREAMS:
                if not ours:
                    raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_STREAMS} pages are open: close one")
                first = min(self._streams, key=self._streams.__getitem__)
                _end(first)
                del self._streams[first]
            self._streams[connection] = ours
            self.served += 1
        try:
            yield
        finally:
            with self.lock:
                self._streams.pop(connection, None)

    def parts(self) -> tuple[bytes, bytes, bytes]:
        """Events with description, log events and state of the run; each is a new object when it changes."""
        with self.lock:
            feed = self.feed
            feed.look(time.monotonic())
            return feed.about, feed.events, feed.state


class _Bounded(io.RawIOBase):
    """Input of a connection, limited in time and bytes. Raises Refused or OSError."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._left = connection, REQUEST_BYTES
        self._until = time.monotonic() + REQUEST_S

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        remaining_s = self._until - time.monotonic()
        if remaining_s <= 0.0:
            raise TimeoutError
        if not self._left:
            raise Refused(
                HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
                f"request too long, allowed: at most {REQUEST_BYTES} bytes",
            )
        self._connection.settimeout(remaining_s)
        count = self._connection.recv_into(memoryview(buffer)[: self._left])
        if not count:
            raise ConnectionAbortedError
        self._left -= count
        return count


class Handler(BaseHTTPRequestHandler):
    """Handles one HTTP request: checks its form and its sender, then answers it."""

    server: Server
    default_request_version = request_version = "HTTP/1.0"
    command = ""

    def setup(self) -> None:
        """Prepare reading of the request within limits of bytes and time."""
        super().setup()
        self.rfile.close()
        self.rfile = io.BufferedReader(_Bounded(self.connection))

    def handle(self) -> None:
        """Answer the request; a broken connection is ignored."""
        with contextlib.suppress(OSError):
            try:
                self.handle_one_request()
            except Refused as refused:
                self._answer(refused.status, f"{refused.why}\n".encode(), "text/plain; charset=utf-8")

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> NoReturn:  # noqa: ARG002
        """Raise Refused for an invalid request."""
        raise Refused(HTTPStatus(code), message or "not a request of HTTP/1.1")

    def log_message(self, *_: object) -> None:
        """Keep no log of requests."""

    def do_GET(self) -> None:
        """Send a file of the page, or the stream of events."""
        request = self._request()
        self.server.access.check(request)
        if request.path == "/stream" and self.command == "GET":
            self._stream(request)
            return
        if request.path in {"/runs", "/report"}:
            self._history(request)
            return
        if request.path not in self.server.assets:
            raise Refused(HTTPStatus.NOT_FOUND, "no such page")
        access = self.server.access
        cookie = {}
        if request.path == "/" and "token" in request.query and access.knows(request):
            cookie["Set-Cookie"] = f"{access.cookie}={access.token}; HttpOnly; SameSite=Strict; Path=/"
        body, media = self.server.assets[request.path]
        self._answer(HTTPStatus.OK, body, media, **cookie)

    do_HEAD = do_GET

    def do_POST(self) -> None:
        """Forward an operator command to the controller, and send its answer."""
        request, operating = self._request(), self.server.operating
        self.server.access.check_operate(request)
        if request.path != "/operate" or operating is None:
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, "allowed here: GET")
        length = request.headers.get("content-length", "")
        if not re.fullmatch("[0-9]{1,3}", length) or int(length) > BODY_BYTES:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"allowed: a body of {BODY_BYTES} bytes")
        try:
            line = line_of(self.rfile.read(int(length)))
        except ValueError as error:
            raise Refused(HTTPStatus.BAD_REQUEST, str(error)) from None
        self._arrived()
        if line == ESTOP:
            taken, why = operating.say(line)
        elif self.server.commands.acquire(blocking=False):
            try:
                taken, why = operating.say(line)
            finally:
                self.server.commands.release()
        else:
            raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_COMMANDS} commands wait for an answer")
        self._answer(HTTPStatus.OK, json.dumps({"taken": taken, "why": why}).encode(), "application/json")

    def _request(self) -> Request:
        names = [name.lower() for name in self.headers]
        if self.headers.defects or len(set(names)) < len(names):
            raise Refused(HTTPStatus.BAD_REQUEST, "a malformed or duplicate header")
        path, _, query = self.path.partition("?")
        try:
            values = parse_qs(query, max_num_fields=8)
        except ValueError:
            raise Refused(HTTPStatus.BAD_REQUEST, "too many fields in the query") from None
        headers = dict(zip(names, self.headers.values(), strict=True))
        return Request(self.command, path, {name: each[-1] for name, each in values.items()}, headers)

    def _arrived(self) -> None:
        """Mark the request as complete, so that the answer may take longer."""
        self.connection.settimeout(PATIENCE_S)
        with self.server.lock:
            if self.connection in self.server.waits:
                self.server.waits[self.connection] = False

    def _head(self, status: HTTPStatus, **headers: str) -> None:
        self.send_response_only(status)
        for name, value in {**_HEADERS, **headers}.items():
            self.send_header(name, value)
        self.end_headers()

    def _answer(self, status: HTTPStatus, body: bytes, media: str, **more: str) -> None:
        self._arrived()
        self._head(status, **{"Content-Type": media, "Content-Length": str(len(body)), **more})
        if self.command != "HEAD":
            self.wfile.write(body)

    def _history(self, request: Request) -> None:
        """Send the list of earlier runs, or a report; both need the token."""
        self.server.access.check_token(request)
        history = self.server.history
        if history is None:
            raise Refused(HTTPStatus.NOT_FOUND, "this page lists no runs")
        self._arrived()
        if request.path == "/runs":
            self._answer(HTTPStatus.OK, json.dumps(history.runs()).encode(), "application/json")
            return
        names = [name for name in (request.query.get("run"), request.query.get("other")) if name]
        self._answer(HTTPStatus.OK, history.page(names), "text/html; charset=utf-8", **_SANDBOX)

    def _stream(self, request: Request) -> None:
        access = self.server.access
        ours = access.knows(request)
        with self.server.stream(self.connection, ours=ours):
            self._arrived()
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BEHIND_BYTES)  # queued data age
            self._head(HTTPStatus.OK, **{"Content-Type": "text/event-stream"})
            hello = {"operate": access.operate and ours, "allowed": access.operate}
            about, _, _ = self.server.parts()
            with self.server.lock:
                past = self.server.feed.past()
            self.wfile.write(event("hello", hello) + about + past)
            del past
            sent = (about, b"", b"")
            while not select.select([self.connection], [], [], PERIOD_S)[0]:  # readable: the viewer has left
                parts = self.server.parts()
                self.wfile.write(
                    b"".join(new for new, old in zip(parts, sent, strict=True) if new is not old)
                )
                sent = parts


def _end(connection: socket.socket) -> None:
    """Wake the thread of a connection, which closes it."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
