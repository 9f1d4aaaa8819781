"""Who may see the page and who may operate: rules on one request, without any state.

The loopback is no protection against pages of other sites in the same browser, nor against a name that an
attacker lets point to it. So Host must be ours, Origin that of the page, and whatever acts carries the token.
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
    """Names in lower case; none of them came twice."""

    @property
    def cookies(self) -> dict[str, str]:
        """Names and values of the header Cookie, those of other servers of the host among them."""
        pairs = (each.strip().partition("=") for each in self.headers.get("cookie", "").split(";"))
        return {name: value for name, _, value in pairs}


@dataclass(frozen=True)
class Access:
    """The rules of one server."""

    token: str
    port: int
    names: frozenset[str]
    """Host names in lower case that are ours."""
    beyond: bool
    """Served to other machines: the token is needed to look, too."""
    operate: bool
    """The configuration allows to operate."""

    def check(self, request: Request) -> None:
        """Refuse a request that may not even look."""
        self._check_host(request.headers.get("host", ""))
        origin = request.headers.get("origin")
        if origin not in {None, f"http://{request.headers.get('host', '')}"}:
            raise Refused(HTTPStatus.FORBIDDEN, "the request comes from a page of another origin")
        if request.headers.get("sec-fetch-site") in {"cross-site", "same-site"} and (
            request.headers.get("sec-fetch-mode") != "navigate" or request.method != "GET"
        ):
            raise Refused(HTTPStatus.FORBIDDEN, "the request comes from a page of another site")
        if self.beyond:
            self._check_token(request)

    def check_operate(self, request: Request) -> None:
        """Refuse a request that may not act."""
        self.check(request)
        if not self.operate:
            raise Refused(
                HTTPStatus.FORBIDDEN, "the configuration does not allow the page to operate (watch.operate)"
            )
        self._check_token(request)
        if "origin" not in request.headers or request.headers.get("content-type") != "application/json":
            raise Refused(HTTPStatus.FORBIDDEN, "allowed: JSON from the page itself, with its Origin")

    def knows(self, request: Request) -> bool:
        """Return whether a request has the token: in the cookie, or in the link that sets it."""
        given = request.cookies.get(self.cookie, "")
        if request.path == "/" and "token" in request.query:
            given = request.query["token"]
        return secrets.compare_digest(given.encode(), self.token.encode())

    @property
    def cookie(self) -> str:
        """Name of the cookie; cookies do not tell ports apart by themselves."""
        return f"hil-watch-{self.port}"

    def _check_token(self, request: Request) -> None:
        if not self.knows(request):
            raise Refused(
                HTTPStatus.UNAUTHORIZED, "open the link with the token that `hil watch` has printed"
            )

    def _check_host(self, host: str) -> None:
        if self.port == HTTP_PORT and not _PORT.search(host):
            host += f":{HTTP_PORT}"  # browsers leave it out
        name, _, port = host.lower().rpartition(":")
        literal = name.removeprefix("[").removesuffix("]")
        if port == str(self.port) and (literal in self.names or (self.beyond and _is_address(literal))):
            return
        raise Refused(HTTPStatus.FORBIDDEN, "this name is not that of the server: open the printed link")


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True
