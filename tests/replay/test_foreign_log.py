"""Logs that other MCAP tools have changed: replay, report and export treat each in the same way."""

from __future__ import annotations

import random

import pytest
from click.testing import CliRunner

from hil.cli import main
from tests.hil.rewrite import rewrite_log
from tests.replay.short_run import moved

COMMANDS = {"replay": [], "report": [], "export": ["out.csv"]}
ORDERS = {
    "reversed": lambda m: reversed(list(m)),
    "shuffled": lambda m: random.Random(1).sample(each := list(m), len(each)),
}
VIDEO = 65 << 20
"""More than a record of ours may have, 64 MiB."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return moved(tmp_path_factory.mktemp("log") / "run.mcap", "desktop", engage={})


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("order", ORDERS)
def test_log_whose_messages_are_out_of_order_is_refused(log, order, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "other.mcap"
    rewrite_log(log, path, order=ORDERS[order])
    done = CliRunner().invoke(main, [command, str(path), *COMMANDS[command]])
    assert done.exit_code == 2, done.output
    assert "messages are not in the order of a recorder" in done.output
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("command", COMMANDS)
def test_log_commands_accept_a_large_attachment_of_another_program(log, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "other.mcap"
    rewrite_log(log, path, attached=VIDEO)
    done = CliRunner().invoke(main, [command, str(path), *COMMANDS[command]])
    assert done.exit_code == 0, done.output
