"""localcan: how long a participant sleeps on until it looks by itself, where no ring has woken it."""

from __future__ import annotations

import pytest

from drivers.can.localcan.participant import Participant

MS = 1_000_000


def slept(node: Participant, monkeypatch: pytest.MonkeyPatch, left_ns: int, *, stands: bool) -> list[float]:
    """Return the naps, s, of one wait for an identifier that nobody has sent, the deadline so far away."""
    naps: list[float] = []
    monkeypatch.setattr(node._bell, "wait", naps.append)
    monkeypatch.setattr(node.clock, "stands", lambda: stands)
    monkeypatch.setattr(node.clock, "now", lambda: 1_000 * MS)
    node.block(1_000 * MS + left_ns, {0x123})
    return naps


@pytest.mark.parametrize("left_ns", [2 * MS, 50 * MS, 10_000 * MS])
def test_while_time_stands_still_it_looks_every_millisecond_for_its_going_on(join, monkeypatch, left_ns):
    assert slept(join(), monkeypatch, left_ns, stands=True) == [0.001]


@pytest.mark.parametrize(("left_ns", "nap_s"), [(2 * MS, 0.002), (50 * MS, 0.05), (10_000 * MS, 0.1)])
def test_while_time_goes_on_it_sleeps_to_the_deadline_in_naps_of_a_tenth_of_a_second(
    join, monkeypatch, left_ns, nap_s
):
    assert slept(join(), monkeypatch, left_ns, stands=False) == [pytest.approx(nap_s)]


@pytest.mark.parametrize("left_ns", [0, -1, -MS])
def test_at_its_deadline_it_does_not_sleep(join, monkeypatch, left_ns):
    assert slept(join(), monkeypatch, left_ns, stands=False) == []
