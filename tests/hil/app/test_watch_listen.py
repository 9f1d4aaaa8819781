"""Where `hil watch` listens: an address that is none is refused in a line, and the link can be opened by others."""

from __future__ import annotations

from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner

from hil.app.configuration.configuration import load
from hil.app.watch import command
from hil.cli import main


@pytest.mark.parametrize(
    "host", ["a..b", "a" * 64, f"robot.{'a' * 64}.example", ".", "r\u00f6bot..", "\udcff"]
)
def test_a_host_whose_name_is_malformed_is_refused_in_a_line(host):
    done = CliRunner().invoke(main, ["watch", "virtual", "--host", host])
    assert done.exit_code == 2, done.exception
    (line,) = done.stderr.splitlines()
    assert "cannot listen on" in line
    assert "allowed: an address of this machine for --host" in line


class Bound:
    """A socket that listens at an address."""

    def __init__(self, address):
        self._address = address

    def getsockname(self):
        return self._address, 8642

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


@pytest.mark.parametrize(
    ("host", "bound", "shown"),
    [
        ("0.0.0.0", "0.0.0.0", "192.0.2.7"),
        ("::", "::", "2001:db8::7"),
        ("127.0.0.1", "127.0.0.1", "127.0.0.1"),
        ("::1", "::1", "::1"),
        ("robot.example", "192.0.2.9", "robot.example"),
    ],
)
def test_the_link_names_a_host_that_other_machines_can_open(monkeypatch, host, bound, shown):
    """Of all addresses at once it is one that they see, and else what was asked for."""

    async def ends(*_):
        pass

    seen_from_elsewhere = {4: "192.0.2.7", 6: "2001:db8::7"}
    monkeypatch.setattr(command, "_listen", lambda *_: Bound(bound))
    monkeypatch.setattr(command, "_serve", ends)
    monkeypatch.setattr(command, "_step_back", lambda _: None)
    monkeypatch.setattr(command, "_reachable", lambda address: seen_from_elsewhere[address.version])
    told: list[str] = []
    summary = command.watch(load("virtual"), host=host, announce=told.append)
    (link,) = told
    assert (urlsplit(link).hostname, urlsplit(link).port) == (shown, 8642)
    assert link.startswith(summary["link"] + "?token=")
