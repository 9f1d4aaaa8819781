"""The bus of a bring-up: whose time is held, when, and what its log and its operator are told of it."""

import io
import tempfile
import threading
import time

import pytest

from drivers.can.bus import Bus
from drivers.can.localcan.bench_clock import BenchClock
from drivers.frame_array import sent_array
from hil.app.compose import build_protocol
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.run.stretching import STRANGER
from hil.lab.bringup import command
from hil.lab.bringup.command import run_bringup
from hil.lab.bringup.context import Context
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.ends import served_end
from hil.lab.bringup.hands import served_bench
from hil.lab.bringup.machine import build_machine
from hil.lab.bringup.procedure import Outcome
from hil.lab.bringup.terminal import Terminal
from hil.record.log import Log


@pytest.fixture
def folder(monkeypatch):
    """The path of a socket has 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        yield name


def shipped(name, folder):
    """Return a shipped configuration that records in a folder."""
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


def test_a_stranger_who_sends_is_named(folder):
    c = shipped("virtual", folder)
    protocol, said = build_protocol(c), list[str]()
    with (
        Bus.open(c.bus, role="controller") as bus,
        Bus.open(c.bus, role="stranger") as other,
        served_bench(c, []),
    ):
        beside = Terminal(said.append, io.StringIO(""))
        with served_end(c, bus, protocol, beside, lambda *_: True, said.append) as end:
            end.line.exchange(())
            other.send(sent_array(protocol.traits.cyclic_frames[:1]))
    assert STRANGER in said


def test_the_log_is_in_universal_time_names_each_bus_and_how_long_time_stood(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    c = shipped("two_buses", folder)

    def stood(c, protocol, end, store, said, **_):
        context = Context(
            build_machine(c, protocol), Drives(protocol, end.line, 0.1, said.tick), end.operator
        )
        exchange = end.line.exchange
        for k in range(3):
            end.line.exchange = lambda opening, k=k: exchange(opening)._replace(stretched_ns=4_500_000 * k)
            context.drives.step()
        return Outcome((), (), stopped="ended"), context, "ended"

    monkeypatch.setattr(command, "_proceed", stood)
    with Bus.open(c.bus, role="bench") as other, served_bench(c, []):
        assert isinstance(other.clock, BenchClock)
        other.clock.begin(1000, 1000)
        other.clock.holds = True
        other.clock.working()
        time.sleep(0.6)
        other.clock.leave()
        summary = run_bringup("two", c, yes=True, say=lambda _: None)
        log = Log.open(summary["log"])
        behind_ns = time.time_ns() - log.epoch_ns - int(log.rows()["t_ns"][-1])
    assert 0 < behind_ns < 500_000_000
    assert log.can_channels == tuple(each.channel for each in c.bus.buses)
    assert summary["bench_time"]["stretches"] == 2
    assert summary["bench_time"]["longest_ms"] == 9.0
    assert "bench time stood still 2 times, 9 ms at most" in (tmp_path / summary["checklist"]).read_text()
