"""What a controller says of itself to its operator."""

import json

import numpy as np

from drivers.arrays import Array
from drivers.signals import NEVER, Fault, Mode
from hil.loop.operating import NO_KEY
from hil.loop.report import waiting_text
from hil.loop.run_end import Course
from hil.mathematics.rotations import rotation_vector


def waits_for(course: Course) -> str:
    """Say what the operator could do for the platform to move; empty where it needs nothing."""
    cycle = course.cycle
    mode, operating = cycle.mode, cycle.operating
    if mode is Mode.WAITING:
        return waiting_text(cycle)
    if mode is Mode.IDLE:
        return "arm: all six drives are ready"
    if mode is Mode.HELD:
        return "release, once the platform is supported: not all brakes are proven shut"
    if mode in {Mode.FAULT, Mode.PARKED} and course.goes_on:
        return "reset, then arm"
    if operating.moves(mode) and not operating.go:
        if not operating.holds_key(int(cycle.tick["tick"])):
            return NO_KEY
        if operating.trouble:
            return f"another order: {operating.trouble}"
        return "start, which first goes back to where the path was left" if cycle.motion.away else "start"
    if operating.moves(mode) and operating.speed == 0.0:
        return "a speed above 0 %"
    return ""


def _known(values: Array) -> list[float] | None:
    """Return values as a list; None where one is not finite, for which JSON has no number."""
    return values.tolist() if np.isfinite(values).all() else None


def status_text(course: Course, malformed: int) -> str:
    """Return the status as JSON; `hil.operate.client.OperatorClient.status` names its keys."""
    cycle = course.cycle
    tick, operating, motion = cycle.tick, cycle.operating, cycle.motion
    number = int(tick["tick"])
    needed = operating.patience is not None
    key = ("held" if operating.holds_key(number) else "missing") if needed else "not needed"
    left = motion.left
    along = motion.time(number) if left is None else left[1]
    length = cycle.parts.trajectory.duration_s
    heard = bool((tick["age"] < NEVER).all())
    turn = np.rad2deg(rotation_vector(tick["R"])) if np.isfinite(tick["R"]).all() else tick["R"]
    return json.dumps(
        {
            "mode": cycle.mode.name,
            "faults": [fault.name for fault in Fault if fault & cycle.faults],
            "tick": number,
            "speed_percent": 100.0 * operating.speed,
            "speed_now_percent": 100.0 * motion.override.sigma,
            "position_m": _known(tick["p"]),
            "rotation_vector_deg": _known(turn),
            "leg_lengths_m": _known(tick["q"]) if heard else None,
            "path_s": along if cycle.mode is Mode.TRACKING else None,
            "path_length_s": length,
            "held": operating.moves(cycle.mode) and not operating.go,
            "key": key,
            "waits_for": waits_for(course),
            "refused_lines": malformed,
        }
    )
