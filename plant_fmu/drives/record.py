"""The record (NODES) of six emulated drives, and the reasons for which a call of `live` returns."""

from collections.abc import Iterator

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


def _fields(kind: str, names: str, *shape: int) -> Iterator[tuple[str, str, tuple[int, ...]]]:
    return ((name, kind, shape) for name in names.split())


_INTEGER, _REAL = "<i8", "<f8"
NODES = np.dtype(
    [
        # Per drive.
        *_fields(_INTEGER, "state fault", LEGS),  # DriveState, DriveFault
        *_fields(_INTEGER, "configured counter", LEGS),  # 1: set up; counter of the last command
        *_fields(_INTEGER, "watchdog_ns deadline_ns", LEGS),  # its time; end of it, or of damping, holding
        *_fields(_INTEGER, "reaction acting", LEGS),  # Reaction to a fault in RUN, to the latched fault
        *_fields(_INTEGER, "lost", LEGS),  # INVALID: no signal from the encoder
        # Per drive: its defects in a rehearsal.
        *_fields(_INTEGER, "number", LEGS),  # leg whose node number it has; MUTE: receives and sends nothing
        *_fields(_INTEGER, "strange", LEGS),  # heartbeat identifier of a MUTE one as at delivery; 0: none
        *_fields(_REAL, "waits", LEGS),  # factor on its watchdog time
        # Per brake.
        *_fields(_INTEGER, "stuck slow_ns", LEGS),  # position, WORKS: not stuck; delay unknown to its drive
        *_fields(_INTEGER, "moved_ns followed_ns", LEGS),  # when a moving one has moved, for its drive; truly
        *_fields(_REAL, "shut truly_shut share", LEGS),  # 1: closed, for its drive; truly; share of its force
        # Per drive: command, encoder, force.
        *_fields(
            _REAL, "command kept", LEGS
        ),  # N, last valid command, zero outside READY and RUN; last force
        *_fields(_REAL, "held_m lagged", LEGS),  # m, position held by HOLD; N, state of the lag
        *_fields(_REAL, "frozen", LEGS),  # m, reading of a frozen encoder; NaN: not frozen
        *_fields(_REAL, "forged", LEGS),  # m, excess length in a second answer of its node; NaN: none
        *_fields(_REAL, "scale shift offset drift", LEGS),  # of the encoder: factor, m, slip m, m/s
        *_fields(_REAL, "gain most", LEGS),  # force factor of the wiring; N, largest force
        # Common to all drives.
        *_fields(
            _INTEGER, "opening_ns closing_ns brake_after_ns"
        ),  # of brakes; from damping, holding to brakes
        *_fields(_REAL, "limit_N damping stiffness"),  # rated force; N s/m of DAMP; N/m of HOLD
        *_fields(_REAL, "lag_end lag_mean"),  # end value and mean of the force lag over one step of the plant
        # Addresses, and the buffer for frames to send.
        *_fields(_INTEGER, "move plant"),  # function and context of the plant, see `Moved`
        *_fields(_INTEGER, "parse answer report end"),  # of the drives' end, see `DrivesEnd`
        *_fields(_INTEGER, "messages asked"),  # MESSAGE elements received; MESSAGE to answer
        *_fields(_INTEGER, "reading senders"),  # READING in the answer; leg of each answer
        *_fields(_INTEGER, "out room sent"),  # FRAME elements to send; capacity; number of frames in it
        # State of the pass.
        *_fields(_INTEGER, "frame heard message"),  # next frame; number of messages in the last one; next one
        *_fields(_INTEGER, "latching"),  # progress in reading the encoders; 0: not reading
        *_fields(_INTEGER, "pending reported due"),  # reports to send; sent; 1: they are heartbeats
        *_fields(_INTEGER, "reports", LEGS),  # legs whose drives send them
        *_fields(_INTEGER, "steps refusal"),  # of the plant; status with which it refused
        # Times.
        *_fields(_INTEGER, "t_ns t0_ns now_ns until_ns"),  # present; start; end of the last pass, of this one
        *_fields(_INTEGER, "k"),  # index of the plant's grid point
        *_fields(_INTEGER, "calm_ns edge_ns"),  # nothing is due before; next start or end of a fault
        *_fields(_INTEGER, "beat beat_ns spoken reading_ns"),  # heartbeats so far, next; unrequested readings
        # Counts, see `Snapshot`.
        *_fields(_INTEGER, "syncs commands repeated rejected"),
        # Tasks of the pass.
        *_fields(_INTEGER, "look silent"),  # LOOKS_BEFORE, LOOKS_AFTER, FORGES; bit i: drive i sends nothing
        *_fields(_INTEGER, "wired controls"),  # 1: some `number` is wrong; a drive in HOLD or DAMP controls
        *_fields(_INTEGER, "lags not_finite geared"),  # 1: force lag; the plant returns NaN; transmission
        # Constants of grid, encoders and time.
        *_fields(_REAL, "h_ns quantum_m"),  # grid step; resolution of the encoders
        *_fields(_REAL, "beat_share reading_share"),  # ns between heartbeats, readings of successive drives
        # Answer of the plant, and transmission between it and the drives.
        *_fields(_REAL, "measured", 3, LEGS),  # lengths m, rates m/s and applied forces N from the plant
        *_fields(_REAL, "length rate wrench", LEGS),  # m, m/s; N, N m on the platform
        *_fields(_REAL, "force brake at_leg", LEGS),  # N before losses; 1: engaged; N after losses
        *_fields(_REAL, "uncounted", LEGS),  # m, length that the encoders do not measure
        *_fields(_REAL, "driving back_driving", LEGS),  # efficiencies, see `Transmission`
        *_fields(_REAL, "full_loss_m_s"),
    ]
)
"""State of six drives, of their time and of the pass."""
