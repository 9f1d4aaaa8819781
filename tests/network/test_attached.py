"""CAN FMUs on localcan in real time, with another participant that is not an FMU."""

import os
import threading
import time

import pytest

from drivers.can.bus_time import BitTiming
from drivers.can.localcan.participant import Participant
from drivers.frame_array import received_frames, sent_array
from drivers.protocol import Frame
from hil.app.bus import run_attached
from hil.loop.clock import fifo_allowed
from plant_fmu.network.attached import Attached
from plant_fmu.network.station import Station, Stations
from tests.network.can_nodes import build_node, demo_node

RATES = BitTiming(500_000, 5_000_000)
MS = 1_000_000
RECEIVED, CONFIRMED = 1, 2


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def test_frames_pass_both_ways_between_can_fmus_and_another_participant(hosted):
    nodes = [hosted(0x100, PERIOD_NS=10 * MS), hosted(0x200, countdown=False)]
    stations = Stations(map(Station, nodes))
    others = [Participant("fmus", RATES, fd=True, own=True) for _ in stations]
    listener = Participant("fmus", RATES, fd=True)
    attached = Attached(stations, others, MS)
    runner = threading.Thread(target=attached.run, args=(300 * MS,))
    runner.start()
    try:
        listener.send(sent_array([Frame(0x300, b"\1")]))
    finally:
        runner.join()
    time.sleep(0.01)
    heard = received_frames(listener.receive())
    for link in (*others, listener):
        link.close()
    data = {each.frame.id: each.frame.data for each in heard}
    assert [each.frame.id for each in heard].count(0x100) == 30
    assert [each.frame.id for each in heard].count(0x200) == 300
    assert data[0x100][CONFIRMED] in range(25, 31)
    assert data[0x200][RECEIVED] in range(25, 32)  # 30 of the other node, one of the participant
    assert set(attached.lateness()) == {"median_us", "p99_us", "largest_us"}


def test_hil_bus_in_real_time_holds_the_priority_that_the_user_may_have(tmp_path, monkeypatch):
    held = []
    monkeypatch.setattr(Attached, "run", lambda *_: held.append(os.sched_getscheduler(0)))
    fmu, allowed = str(build_node(tmp_path, 0x100)), fifo_allowed(70)
    summary = run_attached([fmu], RATES, 1000, 0.01, interface="localcan", channel="first", fd=True)
    assert (held[0] & os.SCHED_FIFO != 0) == allowed
    assert ("SCHED_FIFO" in str(summary["real_time"]["granted"])) == allowed


@pytest.mark.realtime(patient=True)
@pytest.mark.parametrize("clock", ["TriggeredOutput", "Countdown"])
def test_demo_nodes_of_the_standard_exchange_their_frames_on_localcan(clock):
    demo = str(demo_node(clock))
    slow = BitTiming(100_000, 100_000)  # the triggered one configures it
    listener = Participant("demo", slow, fd=False)
    summary = run_attached([demo, demo], slow, 1000, 0.95, interface="localcan", channel="demo", fd=False)
    time.sleep(0.01)
    heard = received_frames(listener.receive())
    listener.close()
    assert [each.frame for each in heard] == [Frame(1, b"\1\2\3\4")] * 6
    assert summary["frames"] == 6
    assert summary["error_frames"] == summary["unsent"] == 0
    for first, second in zip(heard[::2], heard[1::2], strict=True):
        # 4 bytes are 95 bits of 10 us: one after the other, if the host was not held up in between
        assert 0 <= second.t_ns - first.t_ns - 950_000 < 300 * MS
