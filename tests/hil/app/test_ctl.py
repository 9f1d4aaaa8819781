"""`hil ctl`, `hil setpoint` and command files: the commands sent, and the effect of the answers."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Self

import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError, RunError
from hil.app import operate
from hil.app.configuration.address import address
from hil.app.configuration.configuration import load
from hil.app.configuration.text_file import read_configuration
from hil.app.sim.commands import CommandScript, read_commands
from hil.cli import main
from hil.operate.channel import OperatorChannel
from hil.operate.client import Answer
from hil.signals import Operator, Order, SetPoint

STATUS = {
    "mode": "TRACKING", "faults": [], "waits_for": "start", "key": "held", "tick": 1234, "speed_percent": 40.0,
    "speed_now_percent": 0.0, "path_s": 1.5, "path_length_s": None, "position_m": [0.1, 0.2, 1.0],
    "rotation_vector_deg": [0.0, 0.0, 5.0], "leg_lengths_m": [1.5] * 6, "held": True, "refused_lines": 2,
}  # fmt: skip


class Controller:
    """Answers on the bus of `virtual`; with a text in `why` it refuses every command except key."""

    def __init__(self) -> None:
        self.why = ""
        self.heard: list[object] = []
        c = load("virtual")
        self._channel = OperatorChannel(c.bus.interface, c.bus.channel)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work)

    def _work(self) -> None:
        while not self._over.wait(1e-3):
            heard = self._channel.take()
            self.heard += [*heard.operator, *heard.orders, *heard.setpoints]
            operator, orders, setpoints = ([self.why] * len(kind) for kind in heard)
            self._channel.answer(operator, orders, setpoints, lambda: json.dumps(STATUS))

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()
        self._channel.close()


@pytest.fixture
def controller(monkeypatch):
    with tempfile.TemporaryDirectory(prefix="op") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        with Controller() as controller:
            yield controller


def ctl(*words):
    return CliRunner().invoke(main, ["ctl", "virtual", *words])


def test_ctl_exits_with_0_for_an_accepted_and_with_1_for_a_refused_command(controller):
    assert ctl("speed", "40").exit_code == 0
    assert controller.heard == [Order(Operator.SPEED, (0.4,))]
    controller.why = "not now"
    result = ctl("hold")
    assert result.exit_code == 1
    assert "hil: refused: not now" in result.stderr
    result = ctl("speed", "-5")
    assert result.exit_code == 1
    assert "speed: -5 %; allowed: 0 .. 100" in result.stderr


def test_ctl_status_prints_mode_position_and_faults_one_per_line(controller):
    result = ctl("status")
    assert result.exit_code == 0
    lines = dict(line.split("  ", 1) for line in result.output.splitlines())
    lines = {key: value.strip() for key, value in lines.items()}
    assert lines["mode"] == "TRACKING"
    assert lines["waits for"] == "start"
    assert lines["position, m"] == "0.1000  0.2000  1.0000"
    assert lines["faults"] == "none"


def test_ctl_key_repeats_the_key_command_for_the_requested_time(controller):
    assert ctl("key", "--for", "0.5").exit_code == 0
    assert set(controller.heard) == {Order(Operator.KEY)}
    assert 5 <= len(controller.heard) <= 26


def test_ctl_jog_repeats_the_jog_command_until_its_duration_ends_or_it_is_refused(controller):
    assert ctl("jog", "leg3", "-0.5", "--for", "0.3").exit_code == 0
    *said, last = controller.heard
    assert set(said) == {Order(Operator.JOG, (9.0, -0.5))}
    assert 3 <= len(said) <= 16
    assert last == Order(Operator.JOG, (9.0, 0.0))
    controller.heard.clear()
    controller.why = "a limit"
    result = ctl("jog", "x", "1")
    assert result.exit_code == 1
    assert "hil: refused: a limit" in result.stderr
    assert controller.heard == [Order(Operator.JOG, (0.0, 1.0))]


def test_ctl_commands_other_than_key_and_jog_refuse_a_duration(controller):
    assert ctl("hold", "--for", "1").exit_code == 2
    assert not controller.heard


def test_command_without_a_running_controller_is_refused(monkeypatch):
    with tempfile.TemporaryDirectory(prefix="op") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        result = ctl("estop")
    assert result.exit_code == 2
    assert "no controller runs on bus localcan:hil0" in result.stderr


HEAVY = """
import sys
from click.testing import CliRunner
from hil.cli import main
result = CliRunner().invoke(main, ["ctl", "virtual", *sys.argv[1:]])
assert result.exit_code == 2 and "no controller runs" in result.stderr, result.output
heavy = {"numpy", "numba", "pydantic", "rich", "cantools", "mcap"} & set(sys.modules)
assert not heavy, heavy
"""


@pytest.mark.parametrize("word", ["estop", "key"])
def test_command_is_sent_without_heavy_imports(tmp_path, word):
    tmp_path.chmod(0o700)
    ended = subprocess.run(
        [sys.executable, "-c", HEAVY, *word.split()],
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert not ended.returncode, ended.stderr


def changed(tmp_path, old, new):
    text = Path(load("virtual").source).read_text()
    assert old in text
    file = tmp_path / "changed.yaml"
    file.write_text(text.replace(old, new))
    return str(file)


def test_ctl_estop_is_sent_although_the_configuration_has_an_invalid_value(controller, tmp_path):
    file = changed(tmp_path, "mass_kg: 1150", "mass_kg: heavy")
    with pytest.raises(ConfigurationError, match=r"platform\.platform\.mass_kg"):
        load(file)
    assert CliRunner().invoke(main, ["ctl", file, "estop"]).exit_code == 0
    assert controller.heard == [Operator.ESTOP]


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("channel: hil0", "channel: 7.5", "bus.channel: wrong type, allowed: text"),
        ("channel: hil0", "channel: hil0\n  channel: hil1", "bus.channel: key given twice"),
        ("\nbus:", "\nbuss:", "bus: missing"),
    ],
)
def test_ctl_refuses_an_invalid_configuration_without_bus_channel(controller, tmp_path, old, new, complaint):
    result = CliRunner().invoke(main, ["ctl", changed(tmp_path, old, new), "estop"])
    assert result.exit_code == 2
    assert complaint in result.stderr
    assert not controller.heard


def test_ctl_sends_to_the_bus_channel_of_the_configuration(controller, tmp_path):
    result = CliRunner().invoke(main, ["ctl", changed(tmp_path, "channel: hil0", "channel: other"), "estop"])
    assert result.exit_code == 2
    assert "no controller runs on bus localcan:other" in result.stderr
    default = changed(tmp_path, "channel: hil0", "")
    assert CliRunner().invoke(main, ["ctl", default, "estop"]).exit_code == 0
    assert controller.heard == [Operator.ESTOP]


@pytest.mark.parametrize("first", ["two0", "two1"])
def test_ctl_sends_to_the_first_of_several_configured_buses(tmp_path, first):
    file = tmp_path / "two.yaml"
    _, text = read_configuration("two_buses")
    swapped = {"two0": "two1", "two1": "two0"}
    file.write_text(text if first == "two0" else re.sub("two[01]", lambda found: swapped[found[0]], text))
    assert address(file) == (("localcan", first), False)
    bus = load(file).bus
    assert (bus.interface, bus.channel) == ("localcan", first)


def test_set_points_are_accepted_by_a_live_reference_only(controller, tmp_path):
    words = ["--position", "0", "0", "1"]
    result = CliRunner().invoke(main, ["setpoint", "virtual", *words])
    assert result.exit_code == 2
    assert "takes no set-points, allowed: live" in result.stderr
    assert not controller.heard
    file = changed(tmp_path, "type: waypoints", "type: live")
    controller.why = "not now"
    result = CliRunner().invoke(main, ["setpoint", file, *words])
    assert result.exit_code == 1
    assert "not now" in result.output
    assert controller.heard == [SetPoint(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("-1 hold", "time -1.0, allowed: seconds from 0 to"),
        ("nan hold", "time nan"),
        ("1e10 hold", "time 10000000000.0"),
        ("2 jump", "'jump' is not an operator command"),
        ("2 speed 140", "140 %; allowed: 0 .. 100"),
        ("2 jog x 1 for 1e9", "for '1e9', allowed: seconds up to 3600"),
        ("2 status", "a query to a running controller"),
        ("hold", "'hold' is not a time"),
    ],
)
def test_invalid_line_of_a_command_file_is_reported_with_its_line_number(tmp_path, line, told):
    file = tmp_path / "operator.txt"
    file.write_text(f"1 hold\n\n# then\n{line}\n")
    with pytest.raises(ConfigurationError, match=rf"operator\.txt:4: .*{re.escape(told)}"):
        read_commands(file)


class Ending:
    """Answers a number of lines, then has ended."""

    def __init__(self, answers: int) -> None:
        self._left = answers

    def say(self, _line: str) -> Answer:
        if not self._left:
            raise RunError("the controller did not answer: has it ended?")
        self._left -= 1
        return Answer(True, "")

    def key(self) -> None:
        self.say("key")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing to release."""


@pytest.mark.parametrize("words", ["key", "jog x 1", "jog leg3 -0.5 --for 9"])
@pytest.mark.parametrize(("answers", "code"), [(3, 1), (0, 2)])
def test_ctl_fails_if_the_controller_ends_during_a_command(tmp_path, monkeypatch, words, answers, code):
    """A controller that never answered is a refusal with exit code 2."""
    file = tmp_path / "a.json"
    monkeypatch.setattr(operate, "REPEAT_S", 0.0)
    monkeypatch.setattr("hil.operate.client.OperatorClient", lambda *_: Ending(answers))
    result = ctl(*words.split(), "--json", str(file))
    assert (result.exit_code, "has it ended?" in result.stderr) == (code, True)
    assert file.exists() is bool(answers)
    if answers:
        summary = json.loads(file.read_text())
        assert (summary["success"], summary["sent"]) == (False, answers)


def given(rate_Hz: float, *times_s: float, ticks: int = 40) -> list[int]:
    """Ticks in which stops at these times are given."""
    script = CommandScript([(t, "stop") for t in times_s], rate_Hz)
    return [tick for tick in range(ticks) for each in script(tick).operator if each is Operator.STOP]


@pytest.mark.parametrize(
    ("rate_Hz", "t_s", "tick"),
    [
        (1000.0, 0.0, 0),
        (1000.0, 0.007, 7),
        (1000.0, 0.0071, 8),
        (400.0, 0.0175, 7),
        (3000.0, 0.007, 21),
    ],
)
def test_command_of_a_command_file_is_given_in_the_first_tick_at_or_after_its_time(
    rate_Hz: float, t_s: float, tick: int
) -> None:
    assert given(rate_Hz, t_s) == [tick]


def test_command_of_a_command_file_due_in_a_skipped_tick_is_given_in_the_next_tick() -> None:
    script = CommandScript([(0.0045, "stop")], 1000.0)
    assert [script(tick).operator for tick in (4, 10, 11)] == [(), (Operator.STOP,), ()]
    assert script.left == 0


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.01, 1), (0.03, 2), (0.28, 14), (0.29, 15)],
)
def test_repeated_command_of_a_command_file_is_sent_every_20_ms(seconds: float, words: int) -> None:
    script = CommandScript([(1.0, f"jog x 1 for {seconds}")], 1000.0)
    assert [tick for tick in range(2000) if script(tick).orders] == [1000 + 20 * k for k in range(words)]


@pytest.mark.parametrize(("mark", "end"), [("", "\n"), ("\ufeff", "\r\n")], ids=["unix", "windows"])
def test_command_file_may_have_any_line_ending_or_a_utf_8_mark(tmp_path: Path, mark: str, end: str) -> None:
    lines = ["0.5 start # at last", "", "# a remark", "  2  jog x 1 for 1.5 ", "1e1\thold"]
    (tmp_path / "c.txt").write_bytes((mark + end.join(lines) + end).encode())
    assert [(t, " ".join(word.split())) for t, word in read_commands(tmp_path / "c.txt")] == [
        (0.5, "start"), (2.0, "jog x 1 for 1.5"), (10.0, "hold"),
    ]  # fmt: skip
