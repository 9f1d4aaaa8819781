"""localcan in several processes: participants that are killed, stopped, late, or at full load."""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import random
import select
import signal
import time

import pytest

from drivers.can.link import collect
from drivers.can.localcan import layout
from drivers.can.localcan.layout import SLOT_RUNG, slot_at
from drivers.can.localcan.participant import DEFAULT_TIMING, Participant
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import Frame, Received
from tests.drivers.received_frames import CLASSIC_8_BYTES, CRAWL, got, soon

pytestmark = pytest.mark.usefixtures("runtime")


def test_virtual_bus_remains_usable_after_a_sending_process_is_killed(join, child):
    a, b = join(), join()
    for _ in range(4):
        sender = child("while True: node.send([Frame(0x555, bytes(8))] * 4); node.receive()")
        assert got(collect(b, soon()))
        time.sleep(0.05)
        sender.kill()
        sender.wait(10)
        time.sleep(0.02)
        got(b.receive())
        a.send(sent_array([Frame(0x10, b"alive")]))
        assert got(collect(b, soon(1), {0x10}))[-1].frame.data == b"alive"
    # the sender has noticed the dead sockets and the new participant has removed them
    late = join()
    assert len(late._wire.present()) == 3


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_process_killed_or_stopped_while_it_writes_a_frame_does_not_disturb_the_bus(join, child, number):
    sender = child(
        f"""
from drivers.can.localcan import layout, log
def half(words, *given):
    record = layout.record_at(node.serial, 0)
    words[record : record + layout.RECORD_WORDS] = [0, -1, 0, 1, 1000, node.serial, 0x21, *[0] * 8]
    os.kill(os.getpid(), {int(number)})
log.put = half
sys.stdin.readline(); node.send([Frame(0x21, b"never")])
"""
    )
    a, b = join(), join()
    print(file=sender.stdin, flush=True)
    time.sleep(0.1)
    for k in range(50):
        a.send(sent_array([Frame(0x20, k.to_bytes(1, "little"))]))
        (received,) = got(collect(b, soon(), {0x20}))
        assert received.frame.data == k.to_bytes(1, "little")
    assert a.overflow == b.overflow == 0


def start_by_hand(words, sender, number):
    """Append a start to the log like a participant that is killed before it writes the end of the frame."""
    index = max(layout.FIRST, int(words[layout.HINT_AT]))
    entry = (
        index // layout.LOG << layout.LAP_SHIFT | sender.serial % layout.SLOTS << layout.NUMBER_BITS | number
    )
    words[layout.LOG_AT + index % layout.LOG] = entry


@pytest.mark.parametrize("late", [False, True])
def test_frame_ends_at_the_same_time_for_all_although_the_process_that_began_it_was_killed(join, late):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL, own=True)
    assert a.send(sent_array([Frame(0x20, bytes(8)), Frame(0x10, bytes(8))])) == 2
    start_by_hand(b._wire.words, a, 0)
    readers = [b, join(CRAWL), c] if late else [b, c]
    heard = [[(r.t_ns, r.frame.id) for r in got(collect(each, soon(), {0x10}))] for each in readers]
    assert heard[0] == heard[-1]
    (first, _), (second, _) = heard[0]
    assert [id_ for _, id_ in heard[0]] == [0x20, 0x10]
    assert second - first == CLASSIC_8_BYTES * 500_000
    assert heard[1][-1] == heard[0][-1]


def test_joining_and_leaving_the_bus_wait_a_bounded_time_for_a_stopped_process(join, runtime, monkeypatch):
    monkeypatch.setattr("drivers.can.localcan.wire.JOIN_S", 0.2)
    a, b = join(), join()
    with (next((runtime / "hexapod-hil").glob("t.wire*"))).open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        begun = time.monotonic()
        with pytest.raises(BusError, match="kill -CONT"):
            join()
        a.send(sent_array([Frame(1, b"on")]))
        assert got(collect(b, soon(), {1}))
        a.close()
        assert time.monotonic() - begun < 2.0
    join()


def test_reader_is_woken_although_a_sender_was_killed_while_it_notified_readers(join):
    # marked as rung, but without a ring: the next frame after 20 ms rings again
    reader, sender = join(), join()
    reader.arm()
    reader._wire.words[slot_at(reader.serial) + SLOT_RUNG] = time.monotonic_ns()
    time.sleep(0.03)
    sender.send(sent_array([Frame(1, b"")]))
    assert select.select([reader], [], [], 1.0)[0]


def test_new_participant_in_the_slot_of_a_killed_process_does_not_pause_simulated_time(join):
    viewer, killed = join(), join()
    # 1 ns to wake up, 1 ns to work: time stands still at once
    killed.clock.begin(1, 1)
    killed.clock.holds = True
    killed.clock.working()
    assert viewer.clock.stands()
    killed._wire.bell.close()  # without notice to the others, as by the kernel
    newcomer = join()
    assert newcomer.serial % layout.SLOTS == killed.serial % layout.SLOTS
    assert not viewer.clock.stands()
    assert not newcomer.clock.stands()
    killed._closed = True


def test_files_left_by_killed_processes_do_not_disturb_the_next_virtual_bus(join, child, runtime):
    child("node.send([Frame(0x111, bytes(8))] * 60); os.kill(os.getpid(), 9)").wait(10)
    assert list((runtime / "hexapod-hil").iterdir())
    # different timing from the dead bus, none of its frames, and no files at the end
    a, b = join(CRAWL), join(CRAWL)
    a.send(sent_array([Frame(0x10, b"new")]))
    assert [r.frame.id for r in got(collect(b, soon()))] == [0x10]
    a.close()
    b.close()
    assert list((runtime / "hexapod-hil").iterdir()) == []


@pytest.mark.realtime
def test_two_processes_at_full_bus_load_lose_no_frame_and_keep_the_bit_times(join, child):
    node = join()
    child(
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
        received += got(collect(node, soon(0.5)))
    assert [int.from_bytes(r.frame.data, "little") for r in received] == list(range(4000))
    # 34 bit + (5 + 32 + stuff 9 + 4 + 17 + 6) bit at 5 Mbit/s = 34 + 14.6 us, ISO 11898-1
    gaps = [t.t_ns - s.t_ns for s, t in itertools.pairwise(received)]
    assert min(gaps) == 48_600
    assert node.overflow == 0


def test_participant_that_joins_while_another_sends_stays_on_the_bus(join, child):
    child("while True: node.send([Frame(0x55, b'')]); time.sleep(2e-4)")
    node = join()
    for _ in range(60):
        late = Participant("t", DEFAULT_TIMING)
        assert got(collect(late, soon(), {0x55}))
        assert late.serial in node._wire.present()
        late.close()


@pytest.mark.long
def test_all_participants_receive_one_order_of_frames_although_some_are_stopped(join, child, tmp_path):
    """Four processes send, and two of them are stopped and resumed at random; all logs agree."""
    watcher = join()
    code = """
import json, random
random.seed({seed}); seen = []; sys.stdin.readline(); until = time.monotonic() + 2.0
while time.monotonic() < until:
    node.send([Frame(random.randrange(0x100, 0x700), bytes([{seed}, k])) for k in range(random.randrange(3))])
    seen += node.receive()
    time.sleep(random.random() * 1e-3)
time.sleep(0.4); seen += node.receive()
with open("{folder}/{seed}", "w") as file:
    json.dump([(t, f.id, f.data.hex()) for t, f in seen], file)
print("done", flush=True)
"""
    senders = [child(code.replace("{seed}", str(k)).replace("{folder}", str(tmp_path))) for k in range(4)]
    for sender in senders:
        print(file=sender.stdin, flush=True)
    order = random.Random(3)
    seen, until = [], time.monotonic() + 2.0
    while time.monotonic() < until:
        sender = order.choice(senders[:2])
        os.kill(sender.pid, signal.SIGSTOP)
        time.sleep(order.random() * 0.01)
        os.kill(sender.pid, signal.SIGCONT)
        seen += got(watcher.receive())
    assert [sender.stdout.readline() for sender in senders] == ["done\n"] * 4
    logs = [[tuple(each) for each in json.loads((tmp_path / str(k)).read_text())] for k in range(4)]
    seen += got(watcher.receive())
    ends = [t for t, _ in seen]
    assert ends == sorted(set(ends)), "one after the other"
    frames = [(t, f.id, f.data.hex()) for t, f in seen]
    assert len(frames) > 2000
    for seed, log in enumerate(logs):
        others = [each for each in frames if each[2][:2] != f"{seed:02x}"]
        begun = others.index(log[0])
        assert log == others[begun : begun + len(log)]
