"""Clock of a virtual bench: when time stands still, for which participant, and for how long."""

from __future__ import annotations

import os
import signal
import time

import pytest

from drivers.can.localcan.bench_clock import DISMISS_NS
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from tests.drivers.received_frames import got

pytestmark = [pytest.mark.usefixtures("runtime"), pytest.mark.realtime]
WAKE_NS, WORK_NS = 1_000_000, 2_000_000
HOLDS = "clock.holds = True\n"


@pytest.fixture
def held(join):
    """Clock of a participant that holds time, on a wire where time may stand still."""
    node = join()
    node.clock.begin(WAKE_NS, WORK_NS)
    node.clock.holds = True
    return node.clock


def test_simulated_time_pauses_for_a_late_participant_and_then_resumes(held, join):
    viewer = join().clock
    held.working()
    due = held.now() + WORK_NS
    time.sleep(0.03)
    stood = viewer.now()
    assert due - 1_000_000 <= stood <= due
    time.sleep(0.01)
    assert viewer.now() == stood

    held.working()
    resumed = viewer.now()
    assert stood <= resumed < stood + WORK_NS
    assert 0.025e9 < held.stretched() < 1e9


def test_simulated_time_pauses_at_the_earliest_deadline_of_several_participants(held, join):
    second = join().clock
    second.holds = True
    second.waiting(held.now() + 10_000_000)
    held.waiting(held.now() + 500_000_000)
    time.sleep(0.03)
    stood = held.now()
    time.sleep(0.01)
    assert held.now() == stood
    held.working()  # time does not stand still for this one
    assert held.now() == stood
    second.working()
    assert held.now() >= stood
    assert held.stretched() > 0.02e9


def test_sleep_until_a_simulated_time_does_not_end_before_that_time(held, child, join):
    child(HOLDS + f"clock.working(); time.sleep(0.05); clock.waiting(clock.now() + {10**9}); time.sleep(5)")
    time.sleep(0.02)
    assert held.now() == held.now()
    begun, until = time.monotonic(), held.now() + 5_000_000
    held.sleep_until(until)
    assert held.now() >= until
    assert time.monotonic() - begun > 0.02, "time stood still for the other one"


def test_simulated_time_resumes_at_once_after_the_process_it_pauses_for_is_killed(held, child):
    other = child(HOLDS + "clock.working(); print('on', flush=True); time.sleep(30)")
    assert other.stdout.readline() == "on\n"
    os.kill(other.pid, signal.SIGKILL)
    begun, until = time.monotonic(), held.now() + 20_000_000
    held.sleep_until(until)
    assert time.monotonic() - begun < 0.2


def test_simulated_time_stops_waiting_for_a_stopped_process_until_that_process_continues(held, child):
    other = child(
        HOLDS
        + "clock.working(); os.kill(os.getpid(), signal.SIGSTOP); clock.working(); print('on', flush=True);"
        "time.sleep(30)"
    )
    time.sleep(0.05)
    begun, until = time.monotonic(), held.now() + 20_000_000
    held.sleep_until(until)
    took = time.monotonic() - begun
    assert 0.5e-9 * DISMISS_NS < took < 2.0
    os.kill(other.pid, signal.SIGCONT)
    assert other.stdout.readline() == "on\n"
    held.working()
    time.sleep(0.02)
    stood = held.now()
    time.sleep(0.02)
    assert held.now() == stood, "time pauses again for the continued process"


def test_frame_of_a_sender_without_simulated_time_ends_all_pauses_of_that_time(held, join):
    stranger = join()
    got(stranger.receive())
    assert not held.interrupted
    held.working()
    time.sleep(0.02)
    stood = held.now()
    stranger.send(sent_array([Frame(1, b"")]))
    assert held.interrupted
    assert held.now() > stood
    first = held.now()
    time.sleep(0.01)
    assert held.now() >= first + 9_000_000


@pytest.mark.long
def test_simulated_time_never_runs_backwards_for_any_participant(held, child):
    """Two processes that hold time raise, lower and break their promises; a third one reads the clock."""
    code = """
import random
random.seed({})
while True:
    for _ in range(50):
        random.choice([clock.working, lambda: clock.waiting(clock.now() + random.randrange(10**6))])()
        before = clock.now()
        assert clock.now() >= before
    time.sleep(random.random() * 3e-3)
"""
    others = [child(HOLDS + code.format(seed)) for seed in (1, 2)]
    held.leave()
    latest, end = 0, time.monotonic() + 2.0
    first = held.now()
    while time.monotonic() < end:
        now = held.now()
        assert now >= latest
        latest = now
    assert held.now() - first > 0.2e9
    assert all(other.poll() is None for other in others)


def test_sleep_until_a_simulated_time_does_not_busy_wait(join):
    clock = join().clock
    begun, worked = time.monotonic_ns(), time.process_time()
    clock.sleep_until(clock.now() + 60_000_000)
    assert time.monotonic_ns() - begun >= 60_000_000
    assert time.process_time() - worked < 0.02
