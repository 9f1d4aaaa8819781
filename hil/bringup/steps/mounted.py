"""Each leg at its own joints: leg lengths at known poses of the hanging platform."""

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from hil.bringup.context import Context, Finding, Gap, Request
from hil.bringup.step import Step

FIT_M = 4e-3
"""Largest accepted difference of a length at a pose that is known by a jig."""

SAME_M = 1e-3
"""Differences at the poses that differ by less are one."""

MEND = (
    "Mount it at its joints, or mend the geometry. Take the platform off the legs first: what is mended is "
    "measured again, one brake open at a time, on legs that carry nothing."
)


def find(c: Context) -> None:
    """Have the platform hung at the known poses and read the legs, all drives off."""
    for pose in range(len(c.machine.pose_lengths)):
        if c.facts.get("mounted", {}).get(str(pose)) is None:
            text = f"Mount the legs, levers on the brakes, and hang the platform at known pose {pose}"
            c.hung()
            c.ask(Request("hang", -1, float(pose), text))
            c.rest(0.02)
            c.keep("mounted", pose, {"q_m": c.lengths().tolist()})


def judge(c: Context) -> list[Finding]:
    """Name legs whose lengths fit other joints, or none."""
    m, found = c.machine, []
    q = np.array([c.facts["mounted"][str(k)]["q_m"] for k in range(len(m.pose_lengths))])
    for leg in range(LEGS):
        q[:, leg] -= m.turns_m(leg, float((q[:, leg] - m.pose_lengths[:, leg]).mean()))
    for leg in range(LEGS):
        off = q[:, leg] - m.pose_lengths[:, leg]
        if np.abs(off).max() <= FIT_M:
            continue
        fits = _joints(m.joint_distances, q[:, leg])
        if fits is None and np.ptp(off) < SAME_M:
            text = f"at the known poses it reads {1e3 * off.mean():+.1f} mm off, the same at each"
            mend = f"Encoder, belt or coupling has slipped since the tape, or its joint is elsewhere. {MEND}"
            found.append(Finding("slipped", (leg,), text, mend))
            continue
        text = f"at the known poses it is {', '.join(f'{1e3 * x:+.1f}' for x in off)} mm off"
        if fits is None:
            text += ", and fits no pair of joints"
        else:
            text += f", and fits between base joint {fits[0]} and platform joint {fits[1]}"
        found.append(Finding("mounted_elsewhere", (leg,), text, MEND))
    return found


def _joints(distances: Array, q: Array) -> tuple[int, int] | None:
    """Return base and platform joint between which lengths (poses,) m fit best, None where none do."""
    worst = np.abs(distances - q[:, None, None]).max(axis=0)
    base, platform = np.unravel_index(int(np.argmin(worst)), worst.shape)
    return (int(base), int(platform)) if worst[base, platform] <= FIT_M else None


def gap(c: Context) -> Gap | None:
    """Say where drives that forget their turns read alike at other joints."""
    step = c.machine.forgotten_m
    if step is None or float(step.min()) > 4.0 * FIT_M:
        return None
    return Gap(
        f"they forget multiples of {1e3 * float(step.min()):.3g} mm, so a leg that is mounted elsewhere, or "
        "has slipped, may read the length that it should have",
        "Compare the length of each leg at both poses by tape",
    )


STEP = Step(
    "mounted",
    "the platform on its legs",
    "reads the legs with all drives off while the platform hangs at known poses",
    "Ctrl-C; no drive is powered",
    find,
    judge,
    gap=gap,
)
