"""The time from the clock of the kernel's stamps to the monotonic one: which look at both of them counts."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from drivers.can import socketcan

REAL_NS = 1_700_000_000_000_000_000
APART_NS = 5_000_000_000 - REAL_NS
"""Monotonic clock less the other one."""
US = 1_000


def found(monkeypatch: pytest.MonkeyPatch, *looks: tuple[int, int]) -> tuple[int, int]:
    """Return by how much the result is off, and how many looks it took.

    A look has the ns from the first monotonic reading to the other clock's, and from that to the second.
    """
    times = [(at, at + first, at + first + then) for at, (first, then) in enumerate(looks)]
    monotonic = iter([each + 5_000_000_000 for before, _, after in times for each in (before, after)])
    real = iter([REAL_NS + between for _, between, _ in times])
    taken: list[int] = []

    def time_ns() -> int:
        taken.append(next(real))
        return taken[-1]

    stand_in = SimpleNamespace(monotonic_ns=lambda: next(monotonic), time_ns=time_ns)
    monkeypatch.setattr(socketcan, "time", stand_in)
    return socketcan._real_to_monotonic() - APART_NS, len(taken)


CLOSE, STALLED = (2 * US, 2 * US), (2 * US, 900 * US)


@pytest.mark.parametrize("stalls", range(5))
def test_the_first_look_that_no_stall_has_torn_apart_counts_whatever_would_come_behind_it(
    monkeypatch, stalls
):
    looks = [*[STALLED] * stalls, CLOSE, *[STALLED] * (4 - stalls)]
    assert found(monkeypatch, *looks) == (0, stalls + 1)


@pytest.mark.parametrize(("apart_ns", "looks"), [(9_998, 1), (10_000, 2)])
def test_two_readings_of_less_than_10_us_apart_are_close(monkeypatch, apart_ns, looks):
    assert found(monkeypatch, (apart_ns // 2, apart_ns // 2), CLOSE) == (0, looks)


def test_where_every_look_is_torn_apart_the_fifth_counts(monkeypatch):
    off_ns, looks = found(monkeypatch, *[(0, 900 * US)] * 4, (0, 60 * US))
    assert (off_ns, looks) == (30 * US, 5)
