"""Safety and healthy ticks in which single values can be changed, for tests of the combined rules."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.signals import DriveState, Fault, Mode, Stop, Warn
from hil.config.limits import LimitSettings
from hil.contracts.records import record_of
from hil.safety import guard
from hil.safety.certificate import Watch
from tests.hil.encoder_bench import probed

POWERED = (
    *(Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING),
    *(Mode.PARKING, Mode.UNLOADING, Mode.HELD),
)
MOVING = POWERED[1:5]
FOLLOWING = POWERED[1:6]
CLOSED = (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
OFF = (Mode.WAITING, Mode.IDLE, Mode.PARKED, Mode.FAULT)
RATE_HZ = 40.0
"""Rate at which a window has ten ticks."""
PERIOD_NS = 25_000_000
LIMITS = LimitSettings(
    force_N=100.0, force_step_N=50.0, force_window_N=80.0, speed_m_s=3.0, deceleration_m_s2=2.0,
    stroke_margin_m=1.0, following_error_m=0.25, following_error_s=0.5, standstill_m=0.125,
    consistency_m=1e-4, condition=50.0, stale_warn_ticks=2, stale_fault_ticks=5,
)  # fmt: skip


class Judged(NamedTuple):
    """A verdict, and the columns that safety filled."""

    warnings: Warn
    faults: Fault
    stop: Stop
    tau: Array
    certificate: tuple[float, ...]
    """V, its rate, its bound, its share."""
    tau_asked: Array


class Bench:
    """Safety and a healthy tick in which single values can be changed; its output columns hold other
    values before.
    """

    def __init__(self, limits=LIMITS, **options):
        settings = {"drive_force_limit": 1000.0, "length_min": 1.0, "length_max": 9.0, "rate_Hz": RATE_HZ}
        self.safety = guard.Safety(limits, **{**settings, **options})
        self.record = record_of()

    def tick(self, mode=Mode.TRACKING, tau=0.0, **columns):
        healthy = {
            "mode": mode, "recorder_alive": 1, "tau_asked": tau, "condition": 2.0,
            "length": 5.0, "drive_state": DriveState.RUN, "age": 0, "counted_age": columns.get("age", 0),
            "q": 5.0, "R": np.eye(3), "J": np.eye(6), "q_d": 5.0, "R_d": np.eye(3),
            "tau": 77.0, "legs_moved": 0b111111,
        }  # fmt: skip
        tick = record_of(**{**healthy, **columns})
        verdict: guard.Verdict = probed(self.safety, tick, self.record)
        self.record, self.moved_m = tick, self.safety.moved_m(tick)
        certificate = tuple(float(tick[f"lyapunov{name}"]) for name in ("", "_rate", "_bound", "_share"))
        return Judged(*verdict, tick["tau"], certificate, tick["tau_asked"])


def leg(value, other=0.0, dtype=float):
    x = np.full(6, other, dtype)
    x[3] = value
    return x


WARN, FAULT = 1.0, 2.0


def certified(action=WARN, ticks=3, **options):
    """Bench with a watch on V = 4 (de + e)^2 of each axis, which may not grow at all."""
    table = np.zeros((12, 6))
    table[2:5] = 4.0  # P_11, P_12, P_22
    table[5] = 1e3  # disturbance: the reference may jump by 25 m/s
    table[6], table[8] = 1e-6, 1.0  # noise, decay
    table[11] = [0.0, 0.0, 1.0, action, 1.0, 1.0 / RATE_HZ]
    for name, value in options.items():
        row, axis = {"pose": (11, 0), "confirm": (11, 4), "disturbance": (5, 3)}[name]
        table[row, axis] = value
    return Bench(watch=Watch(table, ticks))
