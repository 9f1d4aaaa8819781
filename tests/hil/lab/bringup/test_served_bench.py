"""A bench served by another process: its hands on a socket, refused faults, held time, and its log."""

from __future__ import annotations

import contextlib
import io

import pytest

from drivers.bus_address import BusAddress
from drivers.can.bus import Bus
from drivers.can.localcan.bench_clock import BenchClock
from drivers.errors import ConfigurationError, RunError
from hil.app.compose import build_protocol
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.fault_words import with_faults
from hil.app.run.stretching import STRANGER
from hil.lab.bringup import command
from hil.lab.bringup.command import run_bringup
from hil.lab.bringup.connection import RemoteHands, hands_socket, served_bench, served_end
from hil.lab.bringup.context import Request
from hil.lab.bringup.procedure import Outcome
from hil.lab.bringup.terminal import Terminal

C = load("virtual")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    "fault", ["drive_silence leg=2", "frames_loss probability=0.5", "bus_second_controller rate=100"]
)
def test_fault_without_effect_on_the_virtual_machine_is_refused(fault: str) -> None:
    c = with_faults(C, ["process_slow by=1", fault])
    with pytest.raises(ConfigurationError, match=r"plant\.faults\[1\].*--mistake"), served_bench(c, []):
        pass
    assert not hands_socket(C.bus.interface, C.bus.channel).exists()


def test_operator_actions_on_a_virtual_machine_are_answered_through_a_socket(folder):
    c, address = C, BusAddress(C.bus.interface, C.bus.channel)
    with pytest.raises(RunError, match="no bench is served"):
        RemoteHands(address, lambda *_: True, lambda _: None)
    with served_bench(c, ["end_stop leg=2 value=0.5"]) as bench:
        with contextlib.closing(RemoteHands(address, lambda *_: True, lambda _: None)) as hands:
            lengths = []
            for request in (Request("place", 2, 1.0), Request("measure", 2)):
                hands.ask(request)
                assert hands.answer() is None
                bench.hands()
                lengths.append(hands.answer())
        with pytest.raises(RunError, match="another bench"), served_bench(c, []):
            pass
        hands = RemoteHands(address, lambda *_: True, lambda _: None)
    with contextlib.closing(hands), pytest.raises(RunError, match="the bench has ended"):
        hands.answer()
    # stroke 0.75 to 2.2 m, and 2 % beyond it, less half of it
    assert lengths == [0.0, pytest.approx(2.2 + 0.02 * 1.45 - 0.5 * 1.45, abs=1e-3)]


def test_measurements_of_a_virtual_machine_are_not_used_at_a_real_one(tmp_path, folder, monkeypatch):
    def stopped(context, *, hang):
        context.keep("held", 0, {"moved": False, "hand_N": 700.0})
        return Outcome((), (), stopped="ended"), "ended"

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "_proceed", stopped)
    c = loads(with_changes(C.text, {"recording": {"folder": f"{tmp_path}/runs"}}), "x", C.folder)
    path, said = tmp_path / "state.json", list[str]()
    with served_bench(c, []):
        for _ in range(2):
            run_bringup("x", c, state=path, yes=True, say=said.append)
    assert not any("other hardware" in text for text in said)
    run_bringup("x", c, state=path, say=said.append)
    assert any("other hardware" in text for text in said)


def test_virtual_clock_can_pause_during_bring_up_steps_but_not_during_consent(folder):
    c = loads(with_changes(C.text, {"recording": {"folder": f"{folder}/runs"}}), "virtual", C.folder)
    protocol, said, held = build_protocol(c), list[str](), list[bool]()
    with Bus.open(c.bus, role="controller") as bus, Bus.open(c.bus, role="bench"), served_bench(c, []):
        clock = bus.clock
        assert isinstance(clock, BenchClock)

        def thinks(*_):
            held.append(clock.holds)
            return True

        beside = Terminal(said.append, io.StringIO(""))
        with served_end(c, bus, protocol, beside, thinks, said.append) as (line, operator):
            line.exchange(())
            held.append(clock.holds)
            operator.consent("step", "does", "Ctrl-C")
            held.append(clock.holds)
        held.append(clock.holds)
    assert held == [True, False, True, False]
    assert STRANGER not in said
