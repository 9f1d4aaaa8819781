"""The record (NODES) of six emulated drives, and the reasons for which a call of `live` returns."""

import numpy as np

from drivers.signals import LEGS

(DONE, PLANT, UNSORTED, FULL, EDGE, PARSE, BEFORE_READING, AFTER_READING, ANSWER) = range(9)
"""Reasons for which the pass ends: all is done; the plant refuses its inputs or a step; the frames are not in
the order of time; no room for frames to send; a fault of the plan begins or ends at `t_ns`; Python has to
decode a frame; something acts before, or after, the encoders are read; a reading is not finite."""
MUTE = -1
LOOKS_BEFORE, LOOKS_AFTER, FORGES = 1, 2, 4
"""Bits of `look`."""
ROOM = 128
"""Free elements required before frames are filled in."""
NODES = np.dtype(
    [
        # Per drive.
        ("state", "<i8", (LEGS,)),  # DriveState
        ("fault", "<i8", (LEGS,)),  # DriveFault
        ("configured", "<i8", (LEGS,)),  # 1: set up
        ("counter", "<i8", (LEGS,)),  # counter of the last command
        ("watchdog_ns", "<i8", (LEGS,)),
        ("deadline_ns", "<i8", (LEGS,)),  # end of the watchdog time, or of damping and holding
        ("reaction", "<i8", (LEGS,)),  # Reaction to a fault in RUN
        ("acting", "<i8", (LEGS,)),  # Reaction to the latched fault
        ("lost", "<i8", (LEGS,)),  # INVALID: no signal from the encoder
        # Per drive: its defects in a rehearsal.
        ("number", "<i8", (LEGS,)),  # leg whose node number it has; MUTE: receives and sends nothing
        ("waits", "<f8", (LEGS,)),  # factor on its watchdog time
        ("strange", "<i8", (LEGS,)),  # heartbeat identifier of a MUTE one with factory settings; 0: none
        # Per brake.
        ("stuck", "<i8", (LEGS,)),  # position of a stuck one; WORKS: not stuck
        ("slow_ns", "<i8", (LEGS,)),  # additional delay, unknown to its drive
        ("moved_ns", "<i8", (LEGS,)),  # when a moving one has moved, as its drive assumes
        ("followed_ns", "<i8", (LEGS,)),  # when it has actually moved
        # Per drive: command, encoder, force.
        ("command", "<f8", (LEGS,)),  # N, last valid command; zero outside READY and RUN
        ("held_m", "<f8", (LEGS,)),  # position held by HOLD
        ("lagged", "<f8", (LEGS,)),  # N, state of the lag
        ("frozen", "<f8", (LEGS,)),  # m, reading of a frozen encoder; NaN: not frozen
        ("offset", "<f8", (LEGS,)),  # m, slip of the encoder
        ("forged", "<f8", (LEGS,)),  # m, excess length in a second answer of its node; NaN: none
        ("scale", "<f8", (LEGS,)),  # scale factor of the encoder
        ("shift", "<f8", (LEGS,)),  # m, offset of the encoder
        ("drift", "<f8", (LEGS,)),  # m/s, of the encoder
        ("gain", "<f8", (LEGS,)),  # force factor of the wiring
        ("most", "<f8", (LEGS,)),  # N, largest force of the drive
        # State of the plant.
        ("force", "<f8", (LEGS,)),  # N, force of the drives, before losses
        ("brake", "<f8", (LEGS,)),  # 1: engaged
        ("share", "<f8", (LEGS,)),  # actual share of the brake's force
        ("kept", "<f8", (LEGS,)),  # N, last force of the drive
        ("shut", "<f8", (LEGS,)),  # 1: the brake has closed, 0: it has opened, as its drive assumes
        ("truly_shut", "<f8", (LEGS,)),  # its actual state
        # Common to all drives.
        ("opening_ns", "<i8"),  # duration for a brake
        ("closing_ns", "<i8"),
        ("brake_after_ns", "<i8"),  # time from damping or holding to the brake
        ("limit_N", "<f8"),  # rated force
        ("damping", "<f8"),  # N s/m, of reaction DAMP
        ("stiffness", "<f8"),  # N/m, of reaction HOLD
        ("lag_end", "<f8"),  # end value of the force lag over one step of the plant
        ("lag_mean", "<f8"),  # its mean
        # Addresses, and the buffer for frames to send.
        ("move", "<i8"),  # function and context of the plant, see `Moved`
        ("plant", "<i8"),
        ("parse", "<i8"),  # functions and context of the drives' end, see `DrivesEnd`
        ("answer", "<i8"),
        ("report", "<i8"),
        ("end", "<i8"),
        ("messages", "<i8"),  # MESSAGE elements received
        ("asked", "<i8"),  # MESSAGE to answer
        ("reading", "<i8"),  # READING in the answer
        ("out", "<i8"),  # FRAME elements to send
        ("room", "<i8"),  # its capacity
        ("sent", "<i8"),  # number of frames in it
        ("senders", "<i8"),  # address of the leg of each answer
        # State of the pass.
        ("frame", "<i8"),  # number of the next frame
        ("heard", "<i8"),  # number of messages in the last frame
        ("message", "<i8"),  # number of the next message
        ("latching", "<i8"),  # progress in reading the encoders; 0: not reading
        ("pending", "<i8"),  # reports to send
        ("reported", "<i8"),  # number of reports sent
        ("due", "<i8"),  # 1: the reports are heartbeats
        ("t_ns", "<i8"),  # present time
        ("steps", "<i8"),  # of the plant
        ("refusal", "<i8"),  # status with which the plant refused
        # Times.
        ("t0_ns", "<i8"),  # start
        ("now_ns", "<i8"),  # end of the last pass
        ("until_ns", "<i8"),  # end of this pass
        ("k", "<i8"),  # index of the plant's grid point
        ("calm_ns", "<i8"),  # nothing is due before this time
        ("edge_ns", "<i8"),  # next start or end of a fault
        ("beat", "<i8"),  # number of heartbeats so far
        ("beat_ns", "<i8"),  # time of the next heartbeat
        ("spoken", "<i8"),  # number of unrequested readings so far
        ("reading_ns", "<i8"),  # time of the next unrequested reading
        # Counts, see `Snapshot`.
        ("syncs", "<i8"),
        ("commands", "<i8"),
        ("repeated", "<i8"),
        ("rejected", "<i8"),
        # Tasks of the pass.
        ("look", "<i8"),  # bits LOOKS_BEFORE, LOOKS_AFTER, FORGES
        ("silent", "<i8"),  # bit i: drive i sends nothing
        ("wired", "<i8"),  # 1: some `number` is wrong
        ("controls", "<i8"),  # 1: a drive in HOLD or DAMP controls by its encoder
        ("lags", "<i8"),  # 1: there is a force lag
        ("not_finite", "<i8"),  # 1: the plant returns NaN
        ("geared", "<i8"),  # 1: there is a transmission
        # Constants of grid, encoders and time.
        ("h_ns", "<f8"),  # grid step
        ("quantum_m", "<f8"),  # resolution of the encoders
        ("full_loss_m_s", "<f8"),  # see `Transmission`
        ("beat_share", "<f8"),  # ns between the heartbeats of two successive drives
        ("reading_share", "<f8"),  # the same for readings
        # Answer of the plant, and transmission between it and the drives.
        ("measured", "<f8", (3, LEGS)),  # lengths m, rates m/s and applied forces N from the plant
        ("length", "<f8", (LEGS,)),  # m
        ("rate", "<f8", (LEGS,)),  # m/s
        ("wrench", "<f8", (LEGS,)),  # N, N m on the platform
        ("at_leg", "<f8", (LEGS,)),  # N, forces on the legs, after losses
        ("uncounted", "<f8", (LEGS,)),  # m, length that the encoders do not measure
        ("driving", "<f8", (LEGS,)),  # efficiencies, see `Transmission`
        ("back_driving", "<f8", (LEGS,)),
        ("reports", "<i8", (LEGS,)),  # legs whose drives send reports
    ]
)
"""State of six drives, of their time and of the pass."""
