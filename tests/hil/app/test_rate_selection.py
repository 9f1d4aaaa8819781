"""Rate of `hil run` without SCHED_FIFO, or where it is not kept: slower, refused, or as configured."""

from __future__ import annotations

from typing import Any, NamedTuple

import pytest

from drivers.errors import RunError
from hil.app.configuration.configuration import load
from hil.app.run import command


class Machine(NamedTuple):
    """Share of late wake-ups under SCHED_FIFO (None: denied), holdable rate, and worst stall in s."""

    late: float | None = None
    held_Hz: float = 125.0
    stall_s: float = 0.001


@pytest.fixture
def chosen(monkeypatch):
    def choose(machine: Machine, name: str, *, with_plant: bool, stretching: bool = False, **changes: Any):
        said: list[str] = []
        held = machine.held_Hz, machine.stall_s
        monkeypatch.setattr(command, "fifo_allowed", lambda _: machine.late is not None)
        monkeypatch.setattr(command, "late_share", lambda *_: machine.late)
        monkeypatch.setattr(command, "holdable_rate", lambda *_: held)
        monkeypatch.setattr(command, "warn", said.append)
        c = load(name)
        for section, values in changes.items():
            c = c.model_copy(update={section: getattr(c, section).model_copy(update=values)})
        found = command.select_rate(c, with_plant=with_plant, stretching=stretching)
        return *found, " ".join(said)

    return choose


KEPT, LATE = Machine(late=0.01), Machine(late=0.011)
SLOW = "instead of 1000 Hz"
CASES: dict[str, tuple[Machine, str, bool, dict[str, Any], float, float, str]] = {
    "denied, but held": (Machine(held_Hz=50), "vcan50", False, {}, 50, 0.24, "no right to SCHED_FIFO"),
    "denied": (Machine(), "virtual", True, {}, 125, 0.2, SLOW),
    "long stalls": (Machine(held_Hz=50, stall_s=0.241), "vcan50", False, {}, 50, 0.24, "expect a controlled stop"),
    "watchdog allows it": (Machine(held_Hz=301), "virtual", False, {}, 301, 0.01, SLOW),
    "kept": (KEPT, "virtual", True, {}, 1000, 0.01, ""),
    "not kept": (LATE, "virtual", True, {}, 125, 0.2, "does not keep SCHED_FIFO"),
    "real drives": (LATE, "virtual", False, {}, 1000, 0.01, ""),
    "stalls outlasted": (LATE, "vcan50", True, {}, 50, 0.24, ""),
    "watchdog shorter than a stall": (LATE, "vcan50", True, {"drives": {"watchdog_ms": 39.0}}, 125, 0.2, "watchdog 200 ms"),
    "longer watchdog kept": (Machine(), "virtual", True, {"drives": {"watchdog_ms": 201.0}}, 125, 0.201, "201 ms"),
    "bench time stands still": (LATE, "virtual", True, {"stretching": True}, 1000, 0.01, ""),
}  # fmt: skip


@pytest.mark.parametrize(
    ("machine", "name", "with_plant", "changes", "rate_Hz", "watchdog_s", "words"), CASES.values(), ids=CASES
)
def test_run_selects_a_loop_rate_that_the_computer_holds(
    chosen, machine, name, with_plant, changes, rate_Hz, watchdog_s, words
):
    found_Hz, found_s, said = chosen(machine, name, with_plant=with_plant, **changes)
    assert (found_Hz, found_s) == pytest.approx((rate_Hz, watchdog_s))
    assert words in said
    assert bool(words) == bool(said)


@pytest.mark.parametrize("held_Hz", [50.0, 299.0])
def test_run_is_refused_if_the_watchdog_of_real_drives_would_trip(chosen, held_Hz):
    """Three periods of the loop within 10 ms."""
    with pytest.raises(RunError, match=r"watchdog_ms 10 needs at least 300 Hz"):
        chosen(Machine(held_Hz=held_Hz), "virtual", with_plant=False)


def test_without_realtime_refuse_also_refuses_a_virtual_plant_that_can_pause_its_clock(chosen):
    loop = {"without_realtime": "refuse"}
    with pytest.raises(RunError, match="does not keep SCHED_FIFO"):
        chosen(LATE, "virtual", with_plant=True, stretching=True, loop=loop)
