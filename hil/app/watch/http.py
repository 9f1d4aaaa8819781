"""As much of HTTP/1.1 as the page needs: one request read within bounds, one response as bytes."""

import asyncio
import re
from http import HTTPStatus
from typing import NamedTuple
from urllib.parse import parse_qs, unquote

HEAD_BYTES = 8192
"""Request line and headers."""
BODY_BYTES = 512
PATIENCE_S = 10.0
"""For a whole request, once a connection is open."""
METHODS = ("GET", "HEAD", "POST")
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_TAKEN = frozenset(
    ("host", "origin", "sec-fetch-site", "sec-fetch-mode", "content-type", "content-length", "connection")
)
"""Headers by which a request is judged, beside Cookie: browsers send those of all servers of a host."""
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_SECURITY = (
    f"Content-Security-Policy: {_POLICY}",
    "X-Content-Type-Options: nosniff",
    "Referrer-Policy: no-referrer",
    "Cross-Origin-Resource-Policy: same-origin",
    "Cross-Origin-Opener-Policy: same-origin",
    "Cache-Control: no-store",
)


class Refused(Exception):  # noqa: N818 - an answer, not an error of the program
    """A request that gets no more than a status and a sentence."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status, self.why = status, why


class Request(NamedTuple):
    """A request whose form is right."""

    method: str
    path: str
    query: dict[str, str]
    """The last value of each name."""
    headers: dict[str, str]
    """Names in lower case; none of them came twice. Values as Latin-1, where they are no ASCII."""
    body: bytes

    @property
    def cookies(self) -> dict[str, str]:
        """Names and values of the header Cookie; what is no ASCII is another server's."""
        found = (each.strip() for each in self.headers.get("cookie", "").split(";"))
        pairs = (each.partition("=") for each in found if each.isascii())
        return {name: value for name, _, value in pairs if name}


async def read_request(reader: asyncio.StreamReader) -> Request | None:
    """Read a request; None where the connection ends before it begins.

    reader: its limit is HEAD_BYTES. Raises Refused for what is malformed, too large or too slow.
    """
    try:
        async with asyncio.timeout(PATIENCE_S):
            return await _read(reader)
    except TimeoutError:
        raise Refused(HTTPStatus.REQUEST_TIMEOUT, f"no whole request within {PATIENCE_S:g} s") from None


async def _read(reader: asyncio.StreamReader) -> Request | None:
    try:
        head = await reader.readuntil(b"\r\n\r\n")
    except asyncio.IncompleteReadError as error:
        if not error.partial:
            return None
        raise Refused(HTTPStatus.BAD_REQUEST, "the request breaks off") from None
    except asyncio.LimitOverrunError:
        raise Refused(
            HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, f"allowed: headers of {HEAD_BYTES} bytes"
        ) from None
    request = parse_head(head)
    length = request.headers.get("content-length", "0")
    if "transfer-encoding" in request.headers or not (length.isascii() and length.isdigit()):
        raise Refused(HTTPStatus.BAD_REQUEST, "allowed: a body whose length is given")
    if len(length) > 9 or int(length) > BODY_BYTES:
        raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"allowed: a body of {BODY_BYTES} bytes")
    try:
        return request._replace(body=await reader.readexactly(int(length)))
    except asyncio.IncompleteReadError:
        raise Refused(HTTPStatus.BAD_REQUEST, "the body breaks off") from None


def parse_head(head: bytes) -> Request:
    """Return the request of its head, whose end is an empty line; the body is empty. Raises Refused."""
    first, *lines = head.decode("latin-1").removesuffix("\r\n\r\n").split("\r\n")
    words = first.split(" ")
    if (
        not first.isascii()
        or len(words) != 3
        or words[2] not in {"HTTP/1.1", "HTTP/1.0"}
        or not words[1].startswith("/")
    ):
        raise Refused(HTTPStatus.BAD_REQUEST, "the first line is no request of HTTP/1.1")
    if words[0] not in METHODS:
        raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, f"allowed: {', '.join(METHODS)}")
    headers: dict[str, str] = {}
    for line in lines:
        name, colon, value = line.partition(":")
        key = name.lower()
        malformed = not colon or not name or name != name.strip() or not name.isascii()
        if malformed or key in headers or _CONTROL.search(value):
            raise Refused(HTTPStatus.BAD_REQUEST, "a header that is malformed or comes twice")
        if key in _TAKEN and not value.isascii():
            raise Refused(HTTPStatus.BAD_REQUEST, f"header {key}: a byte that is no ASCII")
        headers[key] = value.strip()
    path, _, query = words[1].partition("?")
    try:
        values = parse_qs(query, max_num_fields=8)
    except ValueError:
        raise Refused(HTTPStatus.BAD_REQUEST, "too many fields in the query") from None
    return Request(words[0], unquote(path), {name: each[-1] for name, each in values.items()}, headers, b"")


def response(status: HTTPStatus, body: bytes, media: str, *more: str, close: bool = False) -> bytes:
    """Return a whole response. more: further header lines, without their ends."""
    lines = [
        f"HTTP/1.1 {status.value} {status.phrase}",
        f"Content-Type: {media}",
        f"Content-Length: {len(body)}",
        *(("Connection: close",) if close else ()),
        *_SECURITY,
        *more,
    ]
    return "\r\n".join([*lines, "", ""]).encode() + body


def stream_head() -> bytes:
    """Return the head of a stream of server-sent events."""
    lines = ["HTTP/1.1 200 OK", "Content-Type: text/event-stream", "Connection: close", *_SECURITY]
    return "\r\n".join([*lines, "", ""]).encode()


def refusal(refused: Refused) -> bytes:
    """Return the response of a refusal, after which the connection is closed."""
    return response(refused.status, f"{refused.why}\n".encode(), "text/plain; charset=utf-8", close=True)
