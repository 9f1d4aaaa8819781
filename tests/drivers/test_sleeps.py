"""Who waits on a virtual bus sleeps meanwhile, as long as it may, and looks often while time stands still."""

import time

import pytest

from drivers.can.localcan import participant
from drivers.clock import MONOTONIC


@pytest.mark.usefixtures("runtime")
def test_until_its_time_a_clock_sleeps_and_does_not_spin(join):
    clock = join().clock
    begun, worked = time.monotonic_ns(), time.process_time()
    clock.sleep_until(clock.now() + 60_000_000)
    assert time.monotonic_ns() - begun >= 60_000_000
    assert time.process_time() - worked < 0.02


@pytest.mark.parametrize(
    ("stands", "left_ms", "expected_s"),
    [
        (False, 5, 0.005),
        (False, 5000, participant._SLICE_S),
        (True, 5, participant.LOOK_S),
        (True, 5000, participant.LOOK_S),
    ],
)
def test_a_participant_sleeps_to_its_deadline_in_slices_and_in_short_ones_while_time_stands(
    join, monkeypatch, stands, left_ms, expected_s
):
    node, waited = join(), list[float]()
    assert participant.LOOK_S < 0.005 < participant._SLICE_S < 5.0
    monkeypatch.setattr(node._wire, "wait", waited.append)
    monkeypatch.setattr(node.clock, "stands", lambda: stands)
    node.block(node.clock.now() + 1_000_000 * left_ms, frozenset())
    assert waited == [pytest.approx(expected_s, abs=2e-3 if not stands and left_ms == 5 else 0.0)]


def test_the_clock_of_the_machine_has_never_stood_still():
    assert MONOTONIC.stretched() == 0
    MONOTONIC.working()
    MONOTONIC.leave()
    assert MONOTONIC.stretched() == 0
