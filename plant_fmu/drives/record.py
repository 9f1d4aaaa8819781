"""The record of six drives, their time and their pass, and why the pass ends."""

import numpy as np

from drivers.signals import LEGS

(
    DONE,
    PLANT,
    UNSORTED,
    FULL,
    WATCHDOG,
    EDGE,
    PARSE,
    MESSAGE_OTHER,
    BEFORE_READING,
    AFTER_READING,
    ANSWER,
    FORGE,
    REPORT,
) = range(13)
"""Why the pass ends: all is done; the plant refuses; the frames are not in the order of time; there is no
room for what is sent; a watchdog is over, or a fault of the plan begins or ends, at `at_ns`; a frame, a
message, an answer or a report is for the owner; something acts before or after the encoders are read."""
LOOKS_BEFORE, LOOKS_AFTER, FORGES = 1, 2, 4
"""Bits of `look`."""
ROOM = 64
"""Room that is there before frames are filled in."""
TIME, HEAR, MESSAGES = range(3)
"""Values of `place`: time passes until the frame; it is heard; its messages are obeyed."""
_WHOLE = ("state", "fault", "configured", "counter", "watchdog_ns", "deadline_ns", "reaction", "acting")
_BRAKE = ("stuck", "slow_ns", "moved_ns", "followed_ns")
_REAL = ("command", "held_m", "lagged", "frozen", "offset", "scale", "shift", "drift", "gain", "most")
_PLANT = ("force", "brake", "share", "kept", "shut", "truly_shut")
_LEGS_AT = ("length", "rate", "wrench", "at_leg", "uncounted", "driving", "back_driving")
NODES = np.dtype(
    [
        *((name, "<i8", (LEGS,)) for name in (*_WHOLE, "lost", *_BRAKE)),
        *((name, "<f8", (LEGS,)) for name in (*_REAL, *_PLANT)),
        *((name, "<i8") for name in ("opening_ns", "closing_ns")),
        *((name, "<f8") for name in ("limit_N", "damping", "stiffness", "lag_end", "lag_mean")),
        *((name, "<i8") for name in ("move", "applied", "plant")),
        *((name, "<i8") for name in ("parse", "answer", "report", "end", "messages", "asked", "reading")),
        *((name, "<i8") for name in ("out", "room", "sent", "senders")),
        *((name, "<i8") for name in ("frame", "place", "heard", "message", "latching", "part")),
        *((name, "<i8") for name in ("pending", "reported", "due", "t_ns", "at_ns", "steps", "refusal")),
        *((name, "<i8") for name in ("t0_ns", "now_ns", "until_ns", "k", "calm_ns", "edge_ns")),
        *((name, "<i8") for name in ("beat", "beat_ns", "spoken", "reading_ns")),
        *((name, "<i8") for name in ("syncs", "commands", "repeated", "rejected")),
        *((name, "<i8") for name in ("look", "silent", "controls", "lags", "not_finite", "geared")),
        *((name, "<f8") for name in ("h_ns", "quantum_m", "full_loss_m_s", "beat_share", "reading_share")),
        ("measured", "<f8", (2 * LEGS,)),
        *((name, "<f8", (LEGS,)) for name in _LEGS_AT),
        ("reports", "<i8", (LEGS,)),
    ]
)
"""State of six drives, of their time and of the pass.

Of each drive: DriveState, DriveFault, 1 if set up, counter of the last command, ns, ns, Reaction of a fault
in RUN, Reaction of the latched fault, INVALID for a lost encoder. Of its brake: where a stuck one stays, ns
that a slow one is later than its drive counts, ns when one that moves has moved, as its drive counts and in
truth. N, last valid command, zero outside READY and RUN; m, where HOLD holds; N, state of the lag; m, what
a frozen encoder reads, NaN for one that works; m, slip of the encoder; how it scales length, and m, what it
adds then; m/s, its drift; gain of the wiring; N, most that the drive gives. What the plant has: N, and 1
for an engaged brake; share of its force that a brake has; N, the drive's last force; 1 for a brake that has
closed, 0 for one that has opened, as its drive counts and in truth. Of all drives: ns that a brake takes;
rated force N, gains of the reactions N s/m and N/m; end value and mean of the force lag over one step of
the plant.

Addresses: functions and context of plant (`Moved`) and drives' end
(`DrivesEnd`); what else listens to each frame; MESSAGE elements heard, the one that is answered, its READING;
FRAME elements to send, how many there may be and are, and the leg of each answer.

Of the pass: frame and what happens to it, messages heard and the next one, whether and how far the encoders
are read, reports to send and sent, whether they are due, the instant now; `at_ns` of what stops it, steps of
the plant and why it refused them. Of time: grid point k of `h_ns` since `t0_ns`, the end of the last pass and
of this one; nothing is due before `calm_ns`; when the next fault, heartbeat and reading is due, how
many have been, and their distance. (6,) m, m/s, N, N at the legs, m that encoders do not count, efficiencies.
"""
