"""Limits and memory of the encoder checks, computed for one robot."""

from math import inf
from typing import NamedTuple, get_type_hints

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.signals import LEGS
from hil.safety.second_encoders import SECOND_MEMORY

ONE6 = np.ones(LEGS)
UNSHARED = 0.3
"""`unshared` where each reading answers a SYNC or poll: other frames may delay it."""
UNASKED = 0.6
"""`unshared` where a timer may have sent the reading: sampled before the poll, it may also have waited for
the bus."""


class EncoderLimits(NamedTuple):
    """Noise, model errors and forces from which the limits of the encoder checks are computed."""

    watched_legs: int
    """Legs whose encoders are checked, bit i: leg i."""
    length_noise_m: float
    rate_noise_m_s: float
    rate_skew_s: float
    """Largest time between the sampling of a rate and of its length, s."""
    rate_error: float
    """Relative error of a measured rate."""
    disturbance_m_s2: float
    """Largest acceleration of a leg, m/s^2, that the model does not contain, friction included."""
    mobility: Array
    """(6, 6) 1/kg: largest acceleration of each leg per force on each leg, |J M^-1 J^T| with a margin."""
    acting_ticks: int
    """Ticks until a force acts in full."""
    push_N: Array
    """(6,) N, force that moves a free leg visibly within `push_ticks`."""
    push_ticks: int
    sticks: int
    """1: friction may hold a leg still, see `hil.safety.residuals`."""
    rise_ticks: int
    """A push of a leg that sticks rises to `push_N` within this number of ticks; 1: at once."""
    open_ticks: int
    """Ticks that the brakes may take to open."""
    period_s: float
    unnamed: int = 0
    """1: feedback does not identify its SYNC or poll, see `hil.safety.encoder_rules.compare`."""
    differences: int = 0
    """1: rates are computed from the last three lengths, see `hil.safety.residuals`."""
    apart: int = 0
    """1: each drive latches by itself: a missed leg shows nothing about the others."""
    unshared: float = UNSHARED
    """Share of a period by which a latch may be late even if another leg contradicts it."""
    friction_N: float = 0.0
    """Dry friction of each leg, N, configured or identified; see `hil.loop.probe`."""
    driving: Array = ONE6
    """Efficiency (6,), 0..1, where the motor drives the leg."""
    back_driving: Array = ONE6
    """Efficiency (6,), 0..1, where the leg drives the motor."""
    mobility_low: Array = ZERO6
    """(6,) 1/kg, smallest acceleration of each leg per force on itself, including the mass that moves along
    the leg."""
    second: int = 0
    """Reaction to second encoders that contradict the drives', see `hil.safety.second_encoders`."""
    second_m: float = 0.0
    """Difference of two encoders at rest that does not count, m; in motion plus rate x `second_late_s`."""
    second_late_s: float = 0.0
    second_ticks: int = 0
    """Ticks until an undecided contradiction counts."""
    tracker_ticks: int = 0
    """Ticks until the tracker has to show which of two encoders is wrong."""
    tracker_s: float = 1.0
    """Time of the mean of the tracker's differences, s."""
    tracker_std_m: float = 0.0
    """Standard deviation of that mean along a leg, m."""


NONE = EncoderLimits(0, 0.0, 0.0, 0.0, 0.0, inf, np.zeros((LEGS, LEGS)), 0, np.zeros(LEGS), 0, 0, 1, 0, 0.0)
"""Limits without any encoder check."""
ENCODER_LIMITS = [
    (name, "<i8" if kind is int else "<f8", np.shape(getattr(NONE, name)))
    for name, kind in get_type_hints(EncoderLimits).items()
]
"""Fields of a record of `EncoderLimits`."""
ENCODER_MEMORY = [
    ("doubt", "<i8"),  # `Doubt`: why the first doubtful leg is
    ("doubted", "<i8"),  # bit i: leg i, of the tick in which that was
    ("doubt_value", "<f8"),  # m or m/s
    ("doubt_limit", "<f8"),
    ("open_for", "<i8"),  # ticks in a row with all drives in RUN
    ("delay_s", "<f8"),  # how much later than the clock says the encoders were latched, summed up
    ("heard_tick", "<i8"),  # the last one in which a leg was heard
    ("missed_tick", "<i8", (LEGS,)),  # tick + 1 in which each leg, or any, was last missed; 0: not yet
    ("heard", "<i8", (LEGS,)),  # tick + 1 in which each leg was last heard; 0: not yet
    ("latched_ns", "<i8", (LEGS,)),
    ("latched_delay_s", "<f8", (LEGS,)),
    ("length_was", "<f8", (LEGS,)),
    ("rate_was", "<f8", (LEGS,)),
    ("spacing_s", "<f8", (LEGS,)),  # over which the last acceleration was taken; 0: unknown
    ("lag_s", "<f8", (LEGS,)),  # of the last rate, where it is a difference
    ("acceleration", "<f8", (LEGS,)),
    ("gaps", "<f8", (LEGS,)),  # m, sums that forget
    ("travel", "<f8", (LEGS,)),
    ("excused", "<f8", (LEGS,)),  # m of them, by a stall
    ("stood", "<i8", (LEGS,)),  # 1: the reading's standstill is being watched
    ("anchor", "<f8", (LEGS,)),  # m, the reading then
    ("began", "<f8", (LEGS, LEGS)),  # m, deviations of all legs then
    ("strays", "<i8"),  # bit i: leg i stands while it or another one strays, and friction may hold it
    ("free_m", "<f8", (LEGS,)),  # how far a free leg would have gone meanwhile
    ("free_m_s", "<f8", (LEGS,)),  # how fast it would be
    ("push", "<i8", (LEGS,)),  # ticks of the push; < 0 retracts the leg
    ("both_ways", "<i8"),  # bit i: the push on leg i goes the other way, too, as an unknown load acts
    ("weighed_tick", "<i8"),  # tick + 1 in which the load was last compared with what acts
    ("weighed", "<i8"),  # ticks in a row for which it was
    ("impulse", "<f8", (LEGS,)),  # N s, of what acted beyond the load meanwhile
    ("rate_then", "<f8", (LEGS,)),  # m/s, rates less those of the reference, before
    ("unsettled_s", "<f8", (LEGS,)),  # until a leg that was pushed follows its reference again
    *SECOND_MEMORY,
]
"""Fields of the encoder rules' memory."""
