"""What the rules on encoders compare with, and what they remember."""

from math import inf
from typing import NamedTuple, get_type_hints

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.signals import LEGS

ONE6 = np.ones(LEGS)
UNSHARED = 0.3
"""`unshared` where each reading answers a SYNC or poll: frames in the way."""
UNASKED = 0.6
"""The same where it may have come by a timer: sampled before the poll, it waited for the bus as long."""


class EncoderLimits(NamedTuple):
    """Stated figures of encoders, model and loads, from which the limits follow."""

    watched_legs: int
    """Bit i: leg i; 0 watches none."""
    length_noise_m: float
    rate_noise_m_s: float
    rate_skew_s: float
    """So far beside the length a rate may be latched."""
    rate_error: float
    """Share of a rate that may be wrong."""
    disturbance_m_s2: float
    """Acceleration of a leg that the model does not know of, friction included."""
    mobility: Array
    """(6, 6) 1/kg: no force on a leg accelerates another by more, |J M^-1 J^T| with a margin."""
    acting_ticks: int
    """After so many ticks a force has come to act in full."""
    push_N: Array
    """(6,) N, under which a free leg has moved visibly within `push_ticks`."""
    push_ticks: int
    sticks: int
    """1: friction may hold a leg still, see `hil.safety.residuals`."""
    rise_ticks: int
    """A push of a leg that sticks rises to `push_N` within this number of ticks; 1: at once."""
    open_ticks: int
    """The brakes get so many ticks to open."""
    period_s: float
    unnamed: int = 0
    """1: no feedback says which SYNC or poll it answers, see `hil.safety.encoder_kernels.compare`."""
    differences: int = 0
    """1: rates are made of the last three lengths, see `hil.safety.residuals`."""
    apart: int = 0
    """1: each drive latches by itself: that a leg was missed says nothing of the others."""
    unshared: float = UNSHARED
    """Share of a period by which a latch may be late although a leg contradicts it."""
    friction_N: float = 0.0
    """Dry friction that is configured or identified, of each leg; see `hil.loop.probe`."""
    driving: Array = ONE6
    """(6,), what is left of a force where the motor drives the leg."""
    back_driving: Array = ONE6
    """(6,), the same where the leg drives the motor."""
    mobility_low: Array = ZERO6
    """(6,) 1/kg, of each leg under a force of its own, the least; what moves along the leg included."""


NONE = EncoderLimits(0, 0.0, 0.0, 0.0, 0.0, inf, np.zeros((LEGS, LEGS)), 0, np.zeros(LEGS), 0, 0, 1, 0, 0.0)
"""No encoder is watched."""
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
]
"""Fields of what the rules remember of encoders."""
