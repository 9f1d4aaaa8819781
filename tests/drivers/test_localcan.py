"""localcan: bit time, arbitration, killed participants."""

from __future__ import annotations

import itertools
import os
import select
import stat
import subprocess
import sys
import tempfile
import time

import pytest

from drivers.can.bus_time import BitTiming
from drivers.can.collect import collect
from drivers.can.localcan.participant import OWN, Participant
from drivers.can.runtime_folder import runtime_folder
from drivers.errors import BusError
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, Frame, Received

pytestmark = pytest.mark.usefixtures("runtime")
FAST = BitTiming(1_000_000, 5_000_000)
SLOW = BitTiming(125_000, 125_000)
CRAWL = BitTiming(2_000, 2_000)
"""A frame of 8 bytes takes 67.5 ms: what has to happen meanwhile does so on a busy machine, too."""
CLASSIC_8_BYTES = 135
"""Worst-case bits, hence 135 us at 1 Mbit/s."""


def soon(seconds=2.0):
    return time.monotonic_ns() + int(seconds * 1e9)


def start(code, timing="1_000_000, 5_000_000", stdin=None):
    """Start a child that is on the bus when this returns."""
    command = [sys.executable, "-c", PREAMBLE.format(timing) + code]
    child = subprocess.Popen(command, stdin=stdin, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    return child


def end(child):
    child.kill()
    child.wait(10)
    child.stdout.close()


PREAMBLE = """
import os, sys, time
from drivers.can.bus_time import BitTiming
from drivers.can.localcan.participant import Participant
from drivers.protocol import Frame
node = Participant("t", BitTiming({}), fd=True)
print("ready", flush=True)
"""


def test_a_frame_takes_its_bit_time(join):
    a, b = join(CRAWL), join(CRAWL)
    before = time.monotonic_ns()
    assert a.send([Frame(0x123, b"12345678")]) == 1
    assert b.receive() == []
    (received,) = collect(b, soon())
    after = time.monotonic_ns()
    assert received.frame == Frame(0x123, b"12345678", 0)
    assert before + CLASSIC_8_BYTES * 500_000 <= received.t_ns <= after


def test_frames_follow_each_other_on_the_wire(join):
    a, b = join(), join()
    frames = [Frame(0x100 + i, bytes(8)) for i in range(20)]
    a.send(frames)
    received = collect(b, soon(), frozenset(frame.id for frame in frames))
    times = [r.t_ns for r in received]
    assert [r.frame for r in received] == frames
    assert {t - s for s, t in itertools.pairwise(times)} == {CLASSIC_8_BYTES * 1000}


def test_lowest_identifier_wins_when_the_bus_falls_free(join):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    # the first frame holds the bus, and the others meet at its end
    a.send([Frame(0x700, bytes(8))])
    a.send([Frame(0x300, b"a")])
    b.send([Frame(0x200, b"b"), Frame(0x100 << 18, b"x", EXTENDED)])
    a.send([Frame(0x100, b"", REMOTE)])
    b.send([Frame(0x100, b"")])
    received = collect(c, soon(), {0x700, 0x200, 0x300})
    assert [(r.frame.id, r.frame.flags) for r in received] == [
        (0x700, 0),
        (0x100, 0),
        (0x100, REMOTE),
        (0x100 << 18, EXTENDED),
        (0x200, 0),
        (0x300, 0),
    ]


def test_every_participant_sees_the_same_order_and_times(join):
    a, b, c = join(), join(own=True), join()
    for i in range(10):
        a.send([Frame(0x200 - i, b"a")])
        b.send([Frame(0x100 + i, b"b")])
    last = soon(0.3)
    seen_by_b, seen_by_c = collect(b, last, {0x7FF}), collect(c, last, {0x7FF})
    assert len(seen_by_c) == 20
    assert [(r.t_ns, r.frame.id) for r in seen_by_b] == [(r.t_ns, r.frame.id) for r in seen_by_c]
    assert sum(bool(r.frame.flags & OWN) for r in seen_by_b) == 10


def test_drain_returns_when_all_wanted_have_come_and_at_the_deadline_otherwise(join):
    a, b = join(CRAWL), join(CRAWL)
    a.send([Frame(1, bytes(8)), Frame(2, bytes(8)), Frame(3, bytes(8))])
    assert [r.frame.id for r in collect(b, soon(), {1, 2})] == [1, 2]
    deadline = soon(0.1)
    assert [r.frame.id for r in collect(b, deadline, {3, 4})] == [3]
    assert 0 <= time.monotonic_ns() - deadline < 60_000_000
    assert collect(b, soon(), frozenset()) == []


def test_send_queue_is_bounded_and_can_be_flushed(join):
    a, b = join(CRAWL, tx_limit=8), join(CRAWL)
    assert a.send([Frame(i, bytes(8)) for i in range(12)]) == 8
    # one of them may have started
    assert 6 <= a.flush_tx() <= 8
    assert a.send([Frame(0x77, b"")]) == 1
    assert collect(b, soon(), {0x77})[-1].frame.id == 0x77


def test_slow_reader_loses_the_oldest_and_is_told(join):
    fast = BitTiming(1_000_000_000, 1_000_000_000)
    a, reader = join(fast), join(fast)
    total = 16384 + 640
    for k in range(0, total, 64):
        frames = [Frame((k + i) & 0x7FF, b"") for i in range(64)]
        while frames:
            frames = frames[a.send(frames) :]
    time.sleep(0.01)
    received = reader.receive()
    assert reader.overflow == 640
    assert len(received) == 16384
    reader.receive()
    assert reader.overflow == 640


def test_error_frame_goes_before_all_that_waits(join):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    a.send([Frame(0x10, bytes(8))])
    a.send([Frame(0x01, b"")])
    b.send([Frame(0, b"", ERROR)])
    received = collect(c, soon(), {0x01})
    assert [(r.frame.id, r.frame.flags) for r in received] == [(0x10, 0), (0, ERROR), (0x01, 0)]


def test_frames_that_this_bus_cannot_carry_are_refused(join):
    node = join(BitTiming(500_000, 500_000), fd=False)
    for frame in (Frame(0x800, b""), Frame(1, bytes(9)), Frame(1, bytes(8), FD), Frame(-1, b"")):
        with pytest.raises(BusError):
            node.send([frame])
    assert node.flush_tx() == 0


def test_timing_is_fixed_by_the_first_who_states_it(join):
    viewer = join(None, None)
    join(FAST)
    assert viewer.timing == FAST
    with pytest.raises(BusError, match=r"CAN FD 1000000/5000000.*asked for was CAN FD 500000/2000000"):
        join(BitTiming(500_000, 2_000_000))
    with pytest.raises(BusError, match=f"classic CAN 1000000.*{os.getpid()}"):
        join(FAST, fd=False)


def test_killed_in_full_flight_leaves_the_bus_usable(join):
    a, b = join(), join()
    for _ in range(4):
        child = start("while True: node.send([Frame(0x555, bytes(8))] * 4); node.receive()")
        assert collect(b, soon())
        time.sleep(0.05)
        end(child)
        time.sleep(0.02)
        b.receive()
        a.send([Frame(0x10, b"alive")])
        assert collect(b, soon(1), {0x10})[-1].frame.data == b"alive"
    # the sender has noticed the deaf sockets and the newcomer has swept them
    late = join()
    assert len([slot for slot in late._wire.slots() if slot.serial]) == 3


def test_killed_with_the_lock_held_and_the_queue_half_rebuilt(join):
    child = start(
        "sys.stdin.readline(); node._wire.lock(); node._wire.memory[40] = 1; os.kill(os.getpid(), 9)",
        stdin=subprocess.PIPE,
        timing="2_000, 2_000",
    )
    a, b = join(CRAWL), join(CRAWL)
    # 4 s of traffic, and the child dies at once
    assert a.send([Frame(0x20, bytes(8))] * 60) == 60
    child.communicate("die\n", timeout=10)
    a.send([Frame(0x22, b"x")])
    assert collect(b, soon(), {0x22})[-1].frame == Frame(0x22, b"x")
    assert 0 < a.overflow == b.overflow <= 60
    assert a.flush_tx() == 0


def test_a_reader_is_woken_although_the_one_who_rang_it_was_killed(join):
    # a rung doorbell that never sounded: the next frame after 20 ms rings again
    reader, sender = join(), join()
    reader.arm()
    reader._wire.lock()
    reader._wire.set_rung(reader.serial, time.monotonic_ns())
    reader._wire.unlock()
    time.sleep(0.03)
    sender.send([Frame(1, b"")])
    assert select.select([reader], [], [], 1.0)[0]


def test_leftovers_of_a_dead_bus_do_not_disturb_the_next(join, runtime):
    child = start("node.send([Frame(0x111, bytes(8))] * 60); os.kill(os.getpid(), 9)")
    child.wait(10)
    end(child)
    assert list((runtime / "hexapod-hil").iterdir())
    # other timing than the dead bus had, none of its frames, and no trace at the end
    a, b = join(SLOW), join(SLOW)
    a.send([Frame(0x10, b"new")])
    assert [r.frame.id for r in collect(b, soon())] == [0x10]
    a.close()
    b.close()
    assert list((runtime / "hexapod-hil").iterdir()) == []


def test_runtime_folder_must_be_the_owners_alone(runtime):
    folder = runtime_folder()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o755)
    with pytest.raises(BusError, match="mode 0700"):
        Participant("t")
    folder.chmod(0o700)
    folder.rmdir()
    folder.symlink_to(tempfile.gettempdir())
    with pytest.raises(BusError, match="0700"):
        Participant("t")


def test_without_runtime_directory_a_folder_of_our_own_is_used(monkeypatch):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    folder = runtime_folder()
    assert folder.name == f"hexapod-hil-{os.getuid()}"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.realtime
def test_two_processes_at_full_load_lose_nothing_and_take_the_bus_time(join):
    node = join()
    child = start(
        """
frames = [Frame(0x100, i.to_bytes(4, "little"), 6) for i in range(4000)]
while frames:
    frames = frames[node.send(frames[:16]):]
    time.sleep(2e-4)
time.sleep(1)
"""
    )
    received: list[Received] = []
    deadline = soon(10)
    while len(received) < 4000 and time.monotonic_ns() < deadline:
        received += collect(node, soon(0.5))
    end(child)
    assert [int.from_bytes(r.frame.data, "little") for r in received] == list(range(4000))
    # 34 bit + (5 + 32 + stuff 9 + 4 + 17 + 6) bit at 5 Mbit/s = 34 + 14.6 us, ISO 11898-1
    gaps = [t.t_ns - s.t_ns for s, t in itertools.pairwise(received)]
    assert min(gaps) == 48_600
    assert node.overflow == 0
