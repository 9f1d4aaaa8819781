"""What `hil run` says of its rate where it may not have SCHED_FIFO or that is not kept."""

from math import nan

import pytest

from drivers.errors import RunError
from hil.app.configuration.configuration import load
from hil.app.output import console
from hil.app.run import rate_selection


@pytest.fixture
def ordinary(monkeypatch):
    """Deny SCHED_FIFO on a machine whose worst wake-up is as told; return what is printed."""
    said = []
    monkeypatch.setattr(rate_selection, "fifo_allowed", lambda _: False)
    monkeypatch.setattr(console, "print", lambda text, **_: said.append(str(text)))

    def machine(rate_Hz, worst_s):
        monkeypatch.setattr(rate_selection, "holdable_rate", lambda *_: (rate_Hz, worst_s))
        return said

    return machine


LACK = "no right to SCHED_FIFO (as root, or `ulimit -r 99` / rtprio in limits.conf)"


def test_a_rate_that_is_held_is_not_called_another(ordinary):
    said = ordinary(50.0, 0.001)
    assert rate_selection.select_rate(load("vcan50"), with_plant=False) == (50.0, 0.24)
    assert said == [LACK]


def test_a_lower_rate_is_named_beside_the_configured_one(ordinary):
    said = ordinary(125.0, 0.001)
    assert rate_selection.select_rate(load("virtual"), with_plant=True) == (125.0, 0.2)
    assert said == [f"{LACK}: the loop runs at 125 Hz instead of 1000 Hz, emulated drives' watchdog 200 ms"]


def test_stalls_that_no_rate_outlasts_are_foretold(ordinary):
    said = ordinary(50.0, 0.241)  # twelve periods of 20 ms stop the platform
    rate_selection.select_rate(load("vcan50"), with_plant=False)
    assert said == [f"{LACK}; stalls of 241 ms now: expect a controlled stop, or take load off this machine"]


@pytest.mark.parametrize("held_Hz", [50.0, 125.0, 299.0])
def test_real_drives_whose_watchdog_the_held_rate_would_trip_do_not_start(ordinary, held_Hz):
    """Three periods of the loop within 10 ms; the configured 1000 Hz are not what runs."""
    said = ordinary(held_Hz, 0.001)
    with pytest.raises(RunError) as refused:
        rate_selection.select_rate(load("virtual"), with_plant=False)
    assert f"holds {held_Hz:g} Hz now, drives.watchdog_ms 10 needs at least 300 Hz" in str(refused.value)
    assert said == []


@pytest.mark.parametrize("held_Hz", [301.0, 500.0])
def test_real_drives_keep_their_watchdog_at_a_lower_rate_that_it_allows(ordinary, held_Hz):
    said = ordinary(held_Hz, 0.001)
    assert rate_selection.select_rate(load("virtual"), with_plant=False) == (held_Hz, 0.01)
    assert said == [f"{LACK}: the loop runs at {held_Hz:g} Hz instead of 1000 Hz"]


@pytest.fixture
def fifo(ordinary, monkeypatch):
    """Grant SCHED_FIFO on a machine with such a share of late wake-ups; return what is printed."""

    def machine(late):
        monkeypatch.setattr(rate_selection, "fifo_allowed", lambda _: True)
        monkeypatch.setattr(rate_selection, "late_share", lambda *_: late)
        return ordinary(125.0, 0.001)

    return machine


def test_a_machine_that_keeps_real_time_runs_at_the_configured_rate(fifo):
    said = fifo(0.01)
    assert rate_selection.select_rate(load("virtual"), with_plant=True) == (1000.0, 0.01)
    assert said == []


def test_with_the_plant_on_a_machine_that_does_not_keep_it_the_loop_is_slowed(fifo):
    said = fifo(0.011)
    assert rate_selection.select_rate(load("virtual"), with_plant=True) == (125.0, 0.2)
    lack = "this machine does not keep SCHED_FIFO, 1.1 % of its wake-ups are 100 us late"
    assert said == [f"{lack}: the loop runs at 125 Hz instead of 1000 Hz, emulated drives' watchdog 200 ms"]


@pytest.mark.parametrize(("name", "with_plant"), [("virtual", False), ("vcan50", True)])
def test_real_drives_and_limits_that_outlast_a_stall_leave_the_rate_as_it_is(fifo, name, with_plant):
    said = fifo(nan)  # not measured
    c = load(name)
    assert rate_selection.select_rate(c, with_plant=with_plant) == (
        c.loop.rate_Hz,
        c.drives.watchdog_ms * 1e-3,
    )
    assert said == []


def test_a_bench_whose_time_stands_still_needs_no_lower_rate(fifo):
    said = fifo(0.5)
    assert rate_selection.select_rate(load("virtual"), with_plant=True, stretching=True) == (1000.0, 0.01)
    assert said == []


def test_who_refuses_to_go_without_real_time_does_so_on_such_a_bench_too(fifo):
    fifo(0.5)
    c = load("virtual")
    c = c.model_copy(update={"loop": c.loop.model_copy(update={"without_realtime": "refuse"})})
    with pytest.raises(RunError, match="does not keep SCHED_FIFO"):
        rate_selection.select_rate(c, with_plant=True, stretching=True)


@pytest.mark.parametrize(
    ("missed", "stale", "periods"), [(50, 5, 5), (5, 50, 5), (3, 7, 3), (7, 3, 3), (4, 4, 4)]
)
def test_the_lesser_limit_counts_where_a_rate_is_looked_for(fifo, monkeypatch, missed, stale, periods):
    asked = []

    def holdable_rate(_rate, periods):
        asked.append(periods)
        return 125.0, 0.0

    said = fifo(0.5)
    monkeypatch.setattr(rate_selection, "holdable_rate", holdable_rate)
    c = load("virtual")
    limits = c.limits.model_copy(update={"missed_stop_ticks": missed, "stale_fault_ticks": stale})
    rate_selection.select_rate(c.model_copy(update={"limits": limits}), with_plant=True)
    assert asked == [periods]
    assert len(said) == 1


@pytest.mark.parametrize(("watchdog_ms", "rate_Hz"), [(30.0, 125.0), (39.0, 125.0), (41.0, 50.0)])
def test_drives_that_switch_off_sooner_than_the_loop_gives_up_do_not_outlast_a_stall(
    fifo, watchdog_ms, rate_Hz
):
    """Of the loop twelve periods of 20 ms may be lost; the stall expected is 40 ms."""
    said = fifo(0.5)
    c = load("vcan50")
    c = c.model_copy(update={"drives": c.drives.model_copy(update={"watchdog_ms": watchdog_ms})})
    assert rate_selection.select_rate(c, with_plant=True)[0] == rate_Hz
    assert len(said) == (rate_Hz != c.loop.rate_Hz)


@pytest.mark.parametrize(
    ("watchdog_ms", "chosen_s"), [(10.0, 0.2), (199.0, 0.2), (201.0, 0.201), (500.0, 0.5)]
)
def test_emulated_drives_are_given_more_time_where_the_loop_is_slowed_and_never_less(
    ordinary, watchdog_ms, chosen_s
):
    said = ordinary(125.0, 0.001)
    c = load("virtual")
    c = c.model_copy(update={"drives": c.drives.model_copy(update={"watchdog_ms": watchdog_ms})})
    rate_Hz, watchdog_s = rate_selection.select_rate(c, with_plant=True)
    assert (rate_Hz, round(1e3 * watchdog_s, 6)) == (125.0, 1e3 * chosen_s)
    assert said[0].endswith(f"emulated drives' watchdog {1e3 * chosen_s:g} ms")
