"""The record of six drives, their time and their pass, and why the pass ends."""

import numpy as np

from drivers.signals import LEGS

(DONE, PLANT, UNSORTED, FULL, EDGE, PARSE, BEFORE_READING, AFTER_READING, ANSWER) = range(9)
"""Why the pass ends: all is done; the plant refuses; the frames are not in the order of time; there is no
room for what is sent; a fault of the plan begins or ends at `t_ns`; a frame is not decoded; something acts
before or after the encoders are read; what is read is not a number."""
MUTE = -1
LOOKS_BEFORE, LOOKS_AFTER, FORGES = 1, 2, 4
"""Bits of `look`."""
ROOM = 128
"""Room that is there before frames are filled in."""
NODES = np.dtype(
    [
        # Of each drive.
        ("state", "<i8", (LEGS,)),  # DriveState
        ("fault", "<i8", (LEGS,)),  # DriveFault
        ("configured", "<i8", (LEGS,)),  # 1: set up
        ("counter", "<i8", (LEGS,)),  # of the last command
        ("watchdog_ns", "<i8", (LEGS,)),
        ("deadline_ns", "<i8", (LEGS,)),  # when the watchdog, or damping and holding, ends
        ("reaction", "<i8", (LEGS,)),  # Reaction to a fault in RUN
        ("acting", "<i8", (LEGS,)),  # Reaction to the latched fault
        ("lost", "<i8", (LEGS,)),  # INVALID: the encoder is lost
        # Of what is wrong with it, in a rehearsal.
        ("number", "<i8", (LEGS,)),  # leg whose node number it has; MUTE: it hears and says nothing
        ("waits", "<f8", (LEGS,)),  # how many times its watchdog takes what was set
        ("strange", "<i8", (LEGS,)),  # identifier of the heartbeat of a MUTE one as delivered; 0: none
        # Of its brake.
        ("stuck", "<i8", (LEGS,)),  # where a stuck one stays; WORKS: it is not stuck
        ("slow_ns", "<i8", (LEGS,)),  # how much later than its drive counts it moves
        ("moved_ns", "<i8", (LEGS,)),  # when one that moves has moved, as its drive counts
        ("followed_ns", "<i8", (LEGS,)),  # the same, in truth
        # Of each drive: command, encoder, force.
        ("command", "<f8", (LEGS,)),  # N, last valid command; zero outside READY and RUN
        ("held_m", "<f8", (LEGS,)),  # where HOLD holds
        ("lagged", "<f8", (LEGS,)),  # N, state of the lag
        ("frozen", "<f8", (LEGS,)),  # m, what a frozen encoder reads; NaN: it works
        ("offset", "<f8", (LEGS,)),  # m, slip of the encoder
        ("forged", "<f8", (LEGS,)),  # m by which a second answer of its node is longer; NaN: no second answer
        ("scale", "<f8", (LEGS,)),  # how the encoder scales length
        ("shift", "<f8", (LEGS,)),  # m, what it adds to that
        ("drift", "<f8", (LEGS,)),  # m/s, of the encoder
        ("gain", "<f8", (LEGS,)),  # of the wiring
        ("most", "<f8", (LEGS,)),  # N, most that the drive gives
        # What the plant has.
        ("force", "<f8", (LEGS,)),  # N, what the drives give, before losses
        ("brake", "<f8", (LEGS,)),  # 1: engaged
        ("share", "<f8", (LEGS,)),  # of its force that a brake has
        ("kept", "<f8", (LEGS,)),  # N, last force of the drive
        ("shut", "<f8", (LEGS,)),  # 1: the brake has closed, 0: it has opened, as its drive counts
        ("truly_shut", "<f8", (LEGS,)),  # the same, in truth
        # Of all drives.
        ("opening_ns", "<i8"),  # how long a brake takes
        ("closing_ns", "<i8"),
        ("brake_after_ns", "<i8"),  # when damping and holding end in the brake
        ("limit_N", "<f8"),  # rated force
        ("damping", "<f8"),  # N s/m, of reaction DAMP
        ("stiffness", "<f8"),  # N/m, of reaction HOLD
        ("lag_end", "<f8"),  # end value of the force lag over one step of the plant
        ("lag_mean", "<f8"),  # its mean
        # Addresses, and the room for frames to send.
        ("move", "<i8"),  # functions and context of the plant, see `Moved`
        ("applied", "<i8"),
        ("plant", "<i8"),
        ("parse", "<i8"),  # functions and context of the drives' end, see `DrivesEnd`
        ("answer", "<i8"),
        ("report", "<i8"),
        ("end", "<i8"),
        ("messages", "<i8"),  # MESSAGE elements heard
        ("asked", "<i8"),  # MESSAGE that is answered
        ("reading", "<i8"),  # READING of the answer
        ("out", "<i8"),  # FRAME elements to send
        ("room", "<i8"),  # how many there may be
        ("sent", "<i8"),  # how many there are
        ("senders", "<i8"),  # address of the leg of each answer
        # Of the pass.
        ("frame", "<i8"),  # number of the next frame
        ("heard", "<i8"),  # number of messages of the last one
        ("message", "<i8"),  # number of the next one
        ("latching", "<i8"),  # how far the reading of encoders has come, 0: no reading
        ("pending", "<i8"),  # reports to send
        ("reported", "<i8"),  # reports sent
        ("due", "<i8"),  # 1: they are heartbeats
        ("t_ns", "<i8"),  # the instant now
        ("steps", "<i8"),  # of the plant
        ("refusal", "<i8"),  # why the plant refused them
        # Of time.
        ("t0_ns", "<i8"),  # the start
        ("now_ns", "<i8"),  # end of the last pass
        ("until_ns", "<i8"),  # end of this one
        ("k", "<i8"),  # grid point of the plant
        ("calm_ns", "<i8"),  # nothing is due before it
        ("edge_ns", "<i8"),  # when the next fault begins or ends
        ("beat", "<i8"),  # heartbeats so far
        ("beat_ns", "<i8"),  # when the next one is due
        ("spoken", "<i8"),  # readings sent unasked so far
        ("reading_ns", "<i8"),  # when the next one is due
        # Counts, see `Snapshot`.
        ("syncs", "<i8"),
        ("commands", "<i8"),
        ("repeated", "<i8"),
        ("rejected", "<i8"),
        # What the pass has to do.
        ("look", "<i8"),  # bits LOOKS_BEFORE, LOOKS_AFTER, FORGES
        ("silent", "<i8"),  # bit i: drive i sends nothing
        ("wired", "<i8"),  # 1: something is wrong with `number`
        ("controls", "<i8"),  # 1: a drive follows its encoder by itself
        ("lags", "<i8"),  # 1: forces lag
        ("not_finite", "<i8"),  # 1: the plant gives NaN
        ("geared", "<i8"),  # 1: there is a transmission
        # Constants of grid, encoders and time.
        ("h_ns", "<f8"),  # step of the grid
        ("quantum_m", "<f8"),  # resolution of the encoders
        ("full_loss_m_s", "<f8"),  # see `Transmission`
        ("beat_share", "<f8"),  # ns from one heartbeat to that of the next drive
        ("reading_share", "<f8"),  # the same for readings
        # What the plant has answered, and what lies between it and the drives.
        ("measured", "<f8", (2 * LEGS,)),  # lengths m and rates m/s from the plant
        ("length", "<f8", (LEGS,)),  # m
        ("rate", "<f8", (LEGS,)),  # m/s
        ("wrench", "<f8", (LEGS,)),  # N, N m on the platform
        ("at_leg", "<f8", (LEGS,)),  # N, forces on the legs, after losses
        ("uncounted", "<f8", (LEGS,)),  # m that encoders do not count
        ("driving", "<f8", (LEGS,)),  # efficiencies, see `Transmission`
        ("back_driving", "<f8", (LEGS,)),
        ("reports", "<i8", (LEGS,)),  # legs whose drives report
    ]
)
"""State of six drives, of their time and of the pass."""
