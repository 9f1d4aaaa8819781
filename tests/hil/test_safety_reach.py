"""The rules work on the six of the legs and on rows that are there, and on nothing that lies behind them."""

import numpy as np
import pytest

from drivers.signals import Mode
from hil.safety import guard
from tests.hil import encoder_bench
from tests.hil.encoder_bench import RATES, T, six
from tests.hil.test_safety import PERIOD_NS, certified, leg
from tests.hil.test_safety_mutation import plain_links


@pytest.fixture(scope="module")
def judge_as_written():
    """The rules of a tick as they are written: where compiled ones would read on behind an array, these stop."""
    links = plain_links()
    return {name: links[name] for name in ("judge", "limit")}


def encoders(**limits):
    wide = {
        "unnamed": 1, "apart": 1, "open_ticks": 2, "length_noise_m": 0.25, "rate_noise_m_s": 0.5, "acting_ticks": 3,
        "disturbance_m_s2": 8.0, "mobility": np.ones((6, 6)), "push_N": six(8.0), "push_ticks": 2,
    }  # fmt: skip
    return encoder_bench.Bench(**{**wide, **limits})


def encoders_in_motion():
    """All are late at once, one is missed, one slips, and one leaps in the end."""
    bench = encoders(differences=1)
    yield bench.tick(mode=Mode.WAITING, rate=100.0 * RATES)
    for n in range(8):
        missed = [n] if n in {3, 5} else ()
        yield bench.tick(unseen=missed, lateness=0.25 * (n == 1), late_s=0.75 * T * (n == 2))
    for n in range(8):
        yield bench.tick(jump=six(0.3 if n == 5 else 0.01, n % 6))
    yield bench.tick(rate=100.0 * RATES + six(99.0, 4))
    yield bench.tick()


def one_encoder_in_motion():
    """It alone shows that all are late, and none contradicts it."""
    bench = encoder_bench.Bench()
    for n in range(4):
        yield bench.tick(rate=six(8.0, 5), late_s=0.9 * T * (n == 2))


def encoders_at_rest():
    """All read the same while the references of two go; they are pushed, and doubted in the end."""
    bench = encoders(sticks=1)
    for n in range(14):
        astray = six(0.0) if n < 4 else np.array([9.0, 0.0, 0.0, 0.0, 0.0, -9.0])
        yield bench.tick(q_d=bench.length + astray)


def forces_and_certificate():
    """The law works; a limit acts, ticks are late or skipped, the law fails, and the brakes close."""
    bench = certified(ticks=3)
    for n in range(18):
        bench.tick(
            Mode.UNLOADING if n > 15 else Mode.FAULT if n > 13 else Mode.TRACKING,
            tau=leg(np.nan if n == 12 else 200.0 * (n == 5)),
            dq=leg(0.1 * (n % 3)),
            dq_d=leg(30.0 * (n == 10)),
            skipped=2 if n == 6 else 0,
            lateness_ns=PERIOD_NS if n == 8 else 0,
            length=leg(5.0 + 0.2 * (n == 17), 5.0),
        )
        yield bench.record


@pytest.mark.parametrize(
    "ticks", [encoders_in_motion, one_encoder_in_motion, encoders_at_rest, forces_and_certificate]
)
def test_the_rules_of_a_tick_reach_nothing_that_is_not_there_and_say_the_same_compiled(
    ticks, judge_as_written, monkeypatch
):
    compiled = [tick.tobytes() for tick in ticks()]
    for name, entry in judge_as_written.items():
        monkeypatch.setattr(guard, name, entry)
    assert [tick.tobytes() for tick in ticks()] == compiled
