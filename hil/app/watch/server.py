"""The server of the live page: bounded in everything that others decide.

So many connections, so many streams, so many bytes and seconds for a request; a watcher that does not read is
left out until it does, and cut off when it has not for long. No queue grows.
"""

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from typing import Any, Protocol

from hil.app.watch.access import Access
from hil.app.watch.feed import Feed, event
from hil.app.watch.http import HEAD_BYTES, Refused, Request, read_request, refusal, response, stream_head
from hil.app.watch.operating import line_of

PERIOD_S = 0.01
"""Between two looks at the mirror, which the recorder fills every 20 ms."""
MOST_CONNECTIONS = 160
MOST_STREAMS = 24
MOST_COMMANDS = 8
"""Under way at once; an emergency stop has a place of its own."""
BEHIND_BYTES = 32768
"""A watcher with so much unread gets no further state until it has read."""
PATIENCE_S = 15.0
"""A watcher that has read nothing for so long is cut off."""
STATUS_S = 0.25
ESTOP = "estop"


class Operates(Protocol):
    """Who passes commands to the controller; both calls may block for a second."""

    def say(self, line: str) -> tuple[bool, str]:
        """Return whether a line was taken, and else why not."""
        ...

    def status(self) -> dict[str, Any] | None:
        """Return what the controller says of itself; None where none answers."""
        ...


class Watcher:
    """One open stream. Mutable state: what it has been sent, and since when it does not read."""

    def __init__(self, writer: asyncio.StreamWriter, *, ours: bool = False) -> None:
        """Take whether it was opened with the token."""
        self._writer, self.ours = writer, ours
        self._run = self._heard = -1
        self._behind_since: float | None = None

    @property
    def behind(self) -> bool:
        """Whether it does not read."""
        return self._behind_since is not None

    def leave(self) -> None:
        """Close the stream; a page opens a new one by itself."""
        self._writer.transport.abort()

    def send(self, feed: Feed, now: float, *, fresh: bool) -> None:
        """Send what is new, or nothing to one that is behind."""
        transport = self._writer.transport
        if transport.is_closing():
            return
        if transport.get_write_buffer_size() > BEHIND_BYTES:
            self._behind_since = now if self._behind_since is None else self._behind_since
            if now - self._behind_since > PATIENCE_S:
                transport.abort()
            return
        self._behind_since = None
        parts = []
        if self._run != feed.run:
            parts.append(feed.about)
        if self._heard != feed.heard:
            parts.append(feed.events)
        if feed.state and (fresh or self._run != feed.run):
            parts.append(feed.state)
        self._run, self._heard = feed.run, feed.heard
        if parts:
            transport.write(b"".join(parts))


class Server:
    """Serves one feed. Mutable state: connections, watchers, commands under way."""

    def __init__(
        self, feed: Feed, access: Access, assets: dict[str, tuple[bytes, str]], operating: Operates | None
    ) -> None:
        self._feed, self._access, self._assets = feed, access, assets
        self._operating = operating
        self._connections: set[asyncio.StreamWriter] = set()
        self._waiting: dict[asyncio.StreamWriter, None] = {}
        """Connections on which no whole request has come yet, the longest wait first."""
        self._watchers: dict[Watcher, None] = {}
        """The longest open first."""
        self._commands = 0
        self._workers = ThreadPoolExecutor(MOST_COMMANDS + 1, "command")
        self._estop = ThreadPoolExecutor(2, "estop")
        self.served = 0
        """Streams that were opened."""

    async def run(self, listening: list[socket.socket], stopped: asyncio.Event) -> None:
        """Serve on sockets until `stopped`."""
        pump = asyncio.create_task(self._pump())
        asking = asyncio.create_task(self._ask(self._operating.status)) if self._operating else None
        servers = [await asyncio.start_server(self._connected, sock=s, limit=HEAD_BYTES) for s in listening]
        try:
            waiting = asyncio.create_task(stopped.wait())
            await asyncio.wait({pump, waiting}, return_when=asyncio.FIRST_COMPLETED)
            waiting.cancel()
            if pump.done():
                pump.result()
        finally:
            for task in (pump, asking):
                if task is not None:
                    task.cancel()
            for server in servers:
                server.close()
            for writer in list(self._connections):
                writer.transport.abort()
            self._workers.shutdown(wait=False, cancel_futures=True)
            self._estop.shutdown(wait=False)

    async def _pump(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            now = time.monotonic()
            if self._watchers:
                fresh = self._feed.look(now)
                for watcher in list(self._watchers):
                    watcher.send(self._feed, now, fresh=fresh)
            due = max(due + PERIOD_S, loop.time())
            await asyncio.sleep(due - loop.time())

    async def _ask(self, status: Callable[[], dict[str, Any] | None]) -> None:
        while True:
            if self._watchers:
                loop = asyncio.get_running_loop()
                self._feed.said = await loop.run_in_executor(self._workers, status)
            await asyncio.sleep(STATUS_S)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._connections) >= MOST_CONNECTIONS:
            first = next(iter(self._waiting), None)
            if first is None:
                writer.transport.abort()
                return
            first.transport.abort()  # those who only wait keep nobody out
            self._waiting.pop(first)
            self._connections.discard(first)
        self._connections.add(writer)
        try:
            await self._serve(reader, writer)
        except Refused as refused:
            writer.write(refusal(refused))
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(1.0):
                    await writer.drain()
        except (OSError, asyncio.CancelledError):
            pass
        finally:
            self._waiting.pop(writer, None)
            self._connections.discard(writer)
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            self._waiting[writer] = None
            request = await read_request(reader)
            self._waiting.pop(writer, None)
            if request is None:
                return
            if request.path == "/stream" and request.method == "GET":
                self._access.check(request)
                await self._stream(request, reader, writer)
                return
            writer.write(await self._answer(request))
            async with asyncio.timeout(PATIENCE_S):
                await writer.drain()
            if request.headers.get("connection", "").lower() == "close":
                return

    async def _answer(self, request: Request) -> bytes:
        if request.path == "/operate":
            return await self._operate(request)
        self._access.check(request)
        if request.method == "POST":
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, "allowed here: GET")
        if request.path not in self._assets:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such page")
        body, media = self._assets[request.path]
        cookie = []
        if request.path == "/" and "token" in request.query and self._access.knows(request):
            name = self._access.cookie
            cookie = [f"Set-Cookie: {name}={self._access.token}; HttpOnly; SameSite=Strict; Path=/"]
        whole = response(HTTPStatus.OK, body, media, *cookie)
        return whole[: len(whole) - len(body)] if request.method == "HEAD" else whole

    async def _stream(
        self, request: Request, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        ours = self._access.knows(request)
        if len(self._watchers) >= MOST_STREAMS:
            self._make_room(ours=ours)
        sock = writer.get_extra_info("socket")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BEHIND_BYTES)  # what waits is old
        may = self._operating is not None and self._access.operate and ours
        hello = {"operate": may, "allowed": self._access.operate}
        writer.write(stream_head() + event("hello", hello))
        watcher = Watcher(writer, ours=ours)
        self._watchers[watcher] = None
        self.served += 1
        try:
            await reader.read(1)  # the end, or words that nobody has asked for
        finally:
            self._watchers.pop(watcher, None)

    def _make_room(self, *, ours: bool) -> None:
        """Close a stream for a new one: one that does not read, else the oldest without the token, or of all.

        ours: the new one has the token. Raises Refused where only streams with it are open, and it has not.
        """
        others = [each for each in self._watchers if ours or not each.ours]
        if not others:
            raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_STREAMS} pages are open: close one of them")
        silent = (each for each in others if each.behind)
        strangers = (each for each in others if not each.ours)
        first = next(silent, None) or next(strangers, None) or others[0]
        self._watchers.pop(first)
        first.leave()

    async def _operate(self, request: Request) -> bytes:
        self._access.check_operate(request)
        if request.method != "POST" or self._operating is None:
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, "allowed here: POST")
        try:
            line = line_of(request.body)
        except ValueError as error:
            raise Refused(HTTPStatus.BAD_REQUEST, str(error)) from None
        loop = asyncio.get_running_loop()
        if line == ESTOP:
            taken, why = await loop.run_in_executor(self._estop, self._operating.say, line)
        elif self._commands >= MOST_COMMANDS:
            raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_COMMANDS} commands wait for an answer")
        else:
            self._commands += 1
            try:
                taken, why = await loop.run_in_executor(self._workers, self._operating.say, line)
            finally:
                self._commands -= 1
        return response(HTTPStatus.OK, json.dumps({"taken": taken, "why": why}).encode(), "application/json")
