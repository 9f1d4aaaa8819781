"""Six encoders in short sequences of ticks, and the verdicts of safety on their readings.

64 ticks a second, T = 1/64 s. By default a bound allows only the travel of a closing brake.
"""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Doubt, DriveState, Mode
from hil.config.limits import LimitSettings
from hil.contracts.records import record_of
from hil.loop.probe import fill_probe
from hil.safety import guard
from hil.safety.encoder_limits import EncoderLimits
from hil.safety.kernels import powered

T = 1.0 / 64.0
PERIOD_NS = 15_625_000
CREEP = 0.02 * T / 2.0
"""Travel, m, of a leg whose brake closes within a tick."""
WIDE = LimitSettings(
    force_N=1e6, force_step_N=1e6, force_window_N=1e6, speed_m_s=1e6, deceleration_m_s2=1e6,
    stroke_margin_m=0.0, following_error_m=1e6, standstill_m=0.125, consistency_m=1.0, condition=1e6,
    stale_warn_ticks=1000, stale_fault_ticks=1000,
)  # fmt: skip
ON_ONE_LEG = pytest.mark.parametrize("leg", [0, 3, 5])
BOTH_SIGNS = pytest.mark.parametrize("sign", [1, -1])
RATES = np.array([2.0, -1.0, 4.0, 0.5, 1.0, -8.0])


def six(value, leg=None, other=0.0, dtype=float):
    """Six times `value`, or six `other` with `value` on one leg."""
    x = np.full(6, value if leg is None else other, dtype)
    if leg is not None:
        x[leg] = value
    return x


class Columns:
    """A record as compiled code sees it: columns are attributes."""

    def __init__(self, record):
        vars(self)["record"] = record

    def __getattr__(self, name):
        return self.record[name][()]

    def __setattr__(self, name, value):
        self.record[name] = value


def probed(safety, tick, last):
    """Verdict of safety on a tick; the probe pushes the suspected legs."""

    def probe():
        if powered(int(tick["mode"])):
            fill_probe(Columns(tick), Columns(last), Columns(safety.limits), Columns(safety.memory))

    return safety.judge(tick, probe)


class Bench:
    """Six legs that move at their rates, and the verdicts of safety on them."""

    def __init__(self, length=5.0, **limits):
        """Take changes of limits that allow nothing."""
        quiet = EncoderLimits(
            watched_legs=63, length_noise_m=0.0, rate_noise_m_s=0.0, rate_skew_s=0.0, rate_error=0.0,
            disturbance_m_s2=0.0, mobility=np.zeros((6, 6)), acting_ticks=0, push_N=np.zeros(6),
            push_ticks=3, sticks=0, rise_ticks=1, open_ticks=10_000, period_s=T,
        )  # fmt: skip
        self.safety = guard.Safety(
            WIDE, drive_force_limit=1e6, length_min=-1e6, length_max=1e6, rate_Hz=64.0,
            encoders=quiet._replace(**limits),
        )  # fmt: skip
        self.n, self.last = -1, record_of()
        self.length, self.rate, self.latched_s = six(length), six(0.0), 0.0

    def tick(self, rate=None, jump=0.0, unseen=(), late_s=0.0, lateness=0, mode=Mode.TRACKING, **columns):
        """Move on to the next sample, `lateness` ticks / 64 and `late_s` behind the clock, and give its record.

        rate: (6,) from now on, at a uniform acceleration; jump: (6,) m, permanent; unseen: legs without
        feedback.
        """
        self.n += 1
        now_s = self.n * T + lateness * T + late_s
        new = self.rate if rate is None else rate + np.zeros(6)
        self.length = self.length + 0.5 * (self.rate + new) * (now_s - self.latched_s) + jump
        self.rate, self.latched_s = new, now_s
        gone = np.isin(np.arange(6), unseen)
        healthy = {
            "tick": self.n, "t_ns": self.n * PERIOD_NS, "lateness_ns": round(lateness * PERIOD_NS),
            "mode": mode, "recorder_alive": 1, "condition": 2.0, "drive_state": DriveState.RUN,
            "length": np.where(gone, 1e3, self.length), "rate": np.where(gone, 7.0, self.rate),
            "age": gone.astype(int), "q_d": self.length, "q": 5.0, "R": np.eye(3), "J": np.eye(6),
            "R_d": np.eye(3), "legs_doubted": 7, "doubt": 2, "doubt_value": 1.0, "doubt_limit": 1.0,
        }  # fmt: skip
        tick = record_of(**{**healthy, **columns})
        self.faults = probed(self.safety, tick, self.last).faults
        self.last = tick
        return tick

    def ticks(self, count, **columns):
        """Last of some ticks without a doubted leg."""
        for _ in range(count):
            tick = self.tick(**columns)
            assert calm(tick)
        return tick

    def memory(self, name):
        """One column of the memory of the rules."""
        return self.safety.memory[name]


def calm(tick):
    """True if the columns of a tick doubt no leg."""
    said = tick["legs_doubted"], tick["doubt"], tick["doubt_value"], tick["doubt_limit"]
    return said == (0, Doubt.NONE, 0.0, 0.0)


def doubted(tick, why, leg, value, limit):
    """True if a tick doubts only this leg, for this reason."""
    said = tick["doubt_value"], tick["doubt_limit"]
    return (tick["legs_doubted"], tick["doubt"]) == (1 << leg, why) and said == pytest.approx((value, limit))


COLUMNS = {"rate", "jump", "unseen", "late_s", "lateness", "mode"}


def after(count, **given):
    """Bench after some calm ticks; given: columns of the ticks, and changed limits."""
    bench = Bench(**{name: value for name, value in given.items() if name not in COLUMNS})
    bench.ticks(count, **{name: value for name, value in given.items() if name in COLUMNS})
    return bench
