"""`hil watch`: serves the live page of the run on the bus of a configuration."""

import contextlib
import importlib.resources
import ipaddress
import os
import secrets
import select
import signal
import socket
import sys
import threading
from pathlib import Path
from typing import Any

from drivers.errors import RunError
from hil.app.configuration.configuration import Configuration
from hil.app.watch.access import Access
from hil.app.watch.feed import Feed
from hil.app.watch.history import History
from hil.app.watch.server import Operating, Server
from hil.record.mirror import mirror_path

LOOPBACK = "127.0.0.1"
PORT = 8642
NICE = 10
"""A tenth of the CPU share of the run's processes; at 19 the page starves on a busy machine."""
_MEDIA = {"html": "text/html", "css": "text/css", "js": "text/javascript", "txt": "text/plain"}


def assets() -> dict[str, tuple[bytes, str]]:
    """Files of the live page: {path: (content, media type)}."""
    folder = importlib.resources.files("hil.app.watch").joinpath("assets")
    files = ((each, _MEDIA.get(each.name.rpartition(".")[2])) for each in folder.iterdir())
    found = {f"/{each.name}": (each.read_bytes(), f"{kind}; charset=utf-8") for each, kind in files if kind}
    return found | {"/": found["/watch.html"]}


def watch(
    c: Configuration,
    *,
    host: str = LOOPBACK,
    port: int | None = None,
    runs: Path | None = None,
    alive: int | None = None,
) -> dict[str, Any]:
    """Serve the live page until Ctrl-C, SIGTERM or the end of file of `alive`; return the summary.

    host: address or name to listen on; beyond the loopback every request needs the token. port: None is PORT,
    or a free port if PORT is in use; 0 is a free port. runs: folder of the listed logs; default: the
    configured one. Raises RunError if the server cannot listen.
    """
    listening = _listen(host, port)
    port = int(listening.getsockname()[1])
    address = ipaddress.ip_address(listening.getsockname()[0])
    beyond = not address.is_loopback
    names = {host.lower(), "localhost", LOOPBACK, "::1", socket.gethostname().lower()}
    access = Access(secrets.token_urlsafe(24), port, frozenset(names), beyond, c.watch.operate)
    operating = Operating(c.bus.interface, c.bus.channel) if c.watch.operate else None
    feed = Feed(mirror_path(c.bus.interface, c.bus.channel))
    history = History(Path(c.recording.folder) if runs is None else runs)
    server = Server(listening, feed, access, assets(), operating, history)
    with contextlib.suppress(OSError):
        os.nice(NICE)
    if elsewhere := os.sched_getaffinity(0) - {c.loop.cpu}:
        os.sched_setaffinity(0, elsewhere)
    shown = _reachable(listening.family) if address.is_unspecified else host
    link = f"http://{f'[{shown}]' if ':' in shown else shown}:{port}/"
    threading.Thread(target=server.serve_forever, daemon=True).start()
    # at the limit of streams, those with the token stay
    print(f"hil: watch at {link}?token={access.token}", file=sys.stderr, flush=True)
    _wait(alive)
    return {
        "success": True,
        "kind": "watch",
        "configuration": c.source,
        "link": link,
        "streams": server.served,
    }


def _wait(alive: int | None) -> None:
    """Wait for a signal to end, or for the end of file of `alive`."""
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)  # in whichever thread the signal arrives
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    select.select([woken] if alive is None else [woken, alive], [], [])


def _listen(host: str, port: int | None) -> socket.socket:
    """Listening socket on a host; without a given port a free one if PORT is in use."""
    tried = (PORT, 0) if port is None else (port,)
    trouble = ""
    for each in tried:
        try:
            family, _, _, _, address = socket.getaddrinfo(host, each, type=socket.SOCK_STREAM)[0]
            return socket.create_server((str(address[0]), each), family=family, backlog=64)
        except (OSError, UnicodeError) as error:  # UnicodeError: an invalid host name
            trouble = str(error)
    raise RunError(
        f"cannot listen on {host} port {tried[0]}: {trouble}; allowed: an address of this machine for "
        "--host, a free port for --port (0 takes any)"
    )


def _reachable(family: int) -> str:
    """Address of this machine on its network, by its routes; sends nothing."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1" if family == socket.AF_INET else "2001:db8::1", 9))
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])
