"""A bench that is served: its hands by a socket, what it refuses, whose time is held, and what the log has."""

from __future__ import annotations

import contextlib
import io
import threading
import time

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
from hil.lab.bringup.context import Context, Request
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.ends import served_end
from hil.lab.bringup.hands import RemoteHands, hands_socket, served_bench
from hil.lab.bringup.machine import build_machine
from hil.lab.bringup.procedure import Outcome
from hil.lab.bringup.terminal import Terminal

C = load("virtual")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    "fault", ["drive_silence leg=2", "frames_loss probability=0.5", "bus_second_controller rate=100"]
)
def test_fault_that_would_never_strike_at_a_bench_is_refused(fault: str) -> None:
    c = with_faults(C, ["process_slow by=1", fault])
    with pytest.raises(ConfigurationError, match=r"plant\.faults\[1\].*--mistake"), served_bench(c, []):
        pass
    assert not hands_socket(C.bus.interface, C.bus.channel).exists()


def test_hands_of_a_served_bench_are_asked_by_a_socket(folder):
    c = load("virtual")
    address = BusAddress(c.bus.interface, c.bus.channel)
    with pytest.raises(RunError, match="nobody serves a bench"):
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


def test_what_a_served_bench_has_shown_says_nothing_of_a_machine(tmp_path, folder, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "_proceed", _stopped)
    c = loads(
        load("virtual").text.replace("folder: runs", f"folder: {tmp_path}/runs"), "x", load("virtual").folder
    )
    path, said = tmp_path / "state.json", list[str]()
    with served_bench(c, []):
        run_bringup("x", c, state=path, yes=True, say=said.append)
    run_bringup("x", c, state=path, say=said.append)
    assert any("other hardware" in text for text in said)


def _stopped(c, protocol, end, store, *_, **__):
    """Keep a fact, and end."""
    context = Context(
        build_machine(c, protocol), Drives(protocol, end.line, 0.1), end.operator, store.facts, store.save
    )
    context.keep("held", 0, {"moved": False, "hand_N": 700.0})
    return Outcome((), (), stopped="ended"), context, "ended"


def shipped(name, folder):
    """A shipped configuration that records in a folder."""
    c = load(name)
    return loads(with_changes(c.text, {"recording": {"folder": f"{folder}/runs"}}), name, c.folder)


def ticks(bus, other, many):
    """Let another participant, which holds time too, look `many` times a ms."""
    other.clock.holds = True
    for _ in range(many):
        other.clock.sleep_until(other.clock.now() + 1_000_000)
    other.clock.leave()
    bus.clock.now()


@pytest.mark.realtime(patient=True)
def test_time_does_not_stand_while_a_person_thinks_and_does_in_the_steps(folder):
    c = shipped("virtual", folder)
    protocol, said = build_protocol(c), list[str]()

    def thinks(*_):
        time.sleep(0.3)
        return True

    with (
        Bus.open(c.bus, role="controller") as bus,
        Bus.open(c.bus, role="bench") as other,
        served_bench(c, []),
    ):
        beside = Terminal(said.append, io.StringIO(""))
        with served_end(c, bus, protocol, beside, thinks, said.append) as end:
            end.line.exchange(())
            before = bus.clock.stretched()
            looking = threading.Thread(target=ticks, args=(bus, other, 100))
            looking.start()
            end.operator.consent("step", "does", "Ctrl-C")
            assert bus.clock.stretched() - before < 50_000_000
            looking.join()
            end.line.exchange(())
            looking = threading.Thread(target=ticks, args=(bus, other, 100))
            looking.start()
            time.sleep(0.1)
            looking.join()
            assert end.line.exchange(()).stretched_ns > 50_000_000
        assert isinstance(bus.clock, BenchClock)
        assert not bus.clock.holds
    assert STRANGER not in said
