"""CAN FMUs on localcan in real time, with another participant that is not an FMU."""

import threading
import time

import pytest

from drivers.can.bus_time import BitTiming
from drivers.can.localcan.participant import Participant
from drivers.frame_array import received_frames, sent_array
from drivers.protocol import Frame
from plant_fmu.network.attached import Attached
from plant_fmu.network.station import Station

RATES = BitTiming(500_000, 5_000_000)
MS = 1_000_000
RECEIVED, CONFIRMED = 1, 2


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def test_frames_pass_both_ways_between_can_fmus_and_another_participant(hosted):
    stations = [Station(hosted(0x100, PERIOD_NS=10 * MS)), Station(hosted(0x200, countdown=False))]
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
    assert set(attached.lateness_us()) == {"median", "p99", "largest"}
