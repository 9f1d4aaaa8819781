"""Access rules of the page of `hil watch`, for viewing and operating, checked for each request.

The loopback address does not protect against pages of other sites in the same browser, or against DNS
rebinding. So Host must be ours, Origin must be the page's, and every command needs the token.
"""

import ipaddress
import re
import secrets
from dataclasses import dataclass
from http import HTTPStatus
from typing import NamedTuple

HTTP_PORT = 80
_PORT = re.compile(r":\d+$")


class Refused(Exception):  # noqa: N818 - an answer, not an error of the program
    """Request that is refused: HTTP status and a sentence."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status, self.why = status, why


class Request(NamedTuple):
    """Well-formed HTTP request to the page."""

    method: str
    path: str
    query: dict[str, str]
    """Last value of each name."""
    headers: dict[str, str]
    """Names in lower case, without duplicates."""

    @property
    def cookies(self) -> dict[str, str]:
        """{name: value} of the header Cookie, including cookies of other servers on the host."""
        pairs = (each.strip().partition("=") for each in self.headers.get("cookie", "").split(";"))
        return {name: value for name, _, value in pairs}


@dataclass(frozen=True)
class Access:
    """Access rules of one page server."""

    token: str
    port: int
    names: frozenset[str]
    """Our host names, in lower case."""
    beyond: bool
    """Served to other machines: viewing needs the token as well."""
    operate: bool
    """The configuration allows operation."""

    def check(self, request: Request) -> None:
        """Raise Refused for a request that may not view the page."""
        self._check_host(request.headers.get("host", ""))
        origin = request.headers.get("origin")
        if origin not in {None, f"http://{request.headers.get('host', '')}"}:
            raise Refused(HTTPStatus.FORBIDDEN, "the request comes from a page of another origin")
        if request.headers.get("sec-fetch-site") in {"cross-site", "same-site"} and (
            request.headers.get("sec-fetch-mode") != "navigate" or request.method != "GET"
        ):
            raise Refused(HTTPStatus.FORBIDDEN, "the request comes from a page of another site")
        if self.beyond:
            self.check_token(request)

    def check_operate(self, request: Request) -> None:
        """Raise Refused for a request that may not send operator commands."""
        self.check(request)
        if not self.operate:
            raise Refused(
                HTTPStatus.FORBIDDEN, "the configuration does not allow the page to operate (watch.operate)"
            )
        self.check_token(request)
        if "origin" not in request.headers or request.headers.get("content-type") != "application/json":
            raise Refused(HTTPStatus.FORBIDDEN, "allowed: JSON from the page itself, with its Origin")

    def knows(self, request: Request) -> bool:
        """True if a request has the token, in the cookie or in the link that sets it."""
        given = request.cookies.get(self.cookie, "")
        if request.path == "/" and "token" in request.query:
            given = request.query["token"]
        return secrets.compare_digest(given.encode(), self.token.encode())

    @property
    def cookie(self) -> str:
        """Name of the token's cookie; includes the port, as browsers share cookies between ports."""
        return f"hil-watch-{self.port}"

    def check_token(self, request: Request) -> None:
        """Raise Refused for a request without the token."""
        if not self.knows(request):
            raise Refused(
                HTTPStatus.UNAUTHORIZED, "open the link with the token that `hil watch` has printed"
            )

    def _check_host(self, host: str) -> None:
        if self.port == HTTP_PORT and not _PORT.search(host):
            host += f":{HTTP_PORT}"  # browsers leave the default port out
        name, _, port = host.lower().rpartition(":")
        literal = name.removeprefix("[").removesuffix("]")
        if port == str(self.port) and (literal in self.names or (self.beyond and _is_address(literal))):
            return
        raise Refused(HTTPStatus.FORBIDDEN, "this host name is not one of the server: open the printed link")


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True
