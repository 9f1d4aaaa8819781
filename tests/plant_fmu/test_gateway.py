"""What others send is put on the bus ahead of its time, by the length of the last step and 2 ms at most."""

from __future__ import annotations

import pytest

from drivers.legs.protocol import LegsProtocol
from plant_fmu.drives import drives_end
from plant_fmu.drives.gateway import Gateway
from plant_fmu.faults.kinds import BusFlood
from plant_fmu.faults.plan import FaultPlan, Schedule

PROTOCOL = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))


MS = 1_000_000


@pytest.mark.parametrize("t0_ms", [0, 1, 3_600_000])
def test_a_sender_is_ahead_by_the_length_of_the_last_step_and_2_ms_at_most_and_heard_in_time(t0_ms):
    t0_ns = t0_ms * MS
    schedule = Schedule(FaultPlan([BusFlood(rate_Hz=2000.0, for_s=0.012)]), t0_ns)
    gateway = Gateway(schedule, PROTOCOL, drives_end(PROTOCOL), t0_ns)
    sent, heard = [], []
    for until_ms in (0.0, 1.0, 1.5, 1.5, 6.5, 8.0, 20.0, 21.0):
        until_ns = t0_ns + round(until_ms * MS)
        heard.append([(each.t_ns - t0_ns) / MS for each in gateway.hear([], until_ns)])
        sent.append([(t_ns - t0_ns) / MS for t_ns, _ in gateway.send([])])
    halves = [0.5 * k for k in range(24)]
    assert sent == [halves[:1], halves[1:5], [], [], halves[5:18], halves[18:20], halves[20:], []]
    assert heard == [halves[:1], halves[1:3], halves[3:4], [], halves[4:14], halves[14:17], halves[17:], []]


def test_what_others_send_is_on_the_bus_2_ms_ahead_and_no_nanosecond_more():
    for late_ns, sent in ((0, [8_500_000]), (1, [])):
        flood = BusFlood(rate_Hz=1.0, at_s=1e-9 * (8_500_000 + late_ns))
        schedule = Schedule(FaultPlan([flood]), 0)
        gateway = Gateway(schedule, PROTOCOL, drives_end(PROTOCOL), 0)
        assert gateway.hear([], 6_500_000) == []
        assert [t_ns for t_ns, _ in gateway.send([])] == sent
