"""Whether a leg can be pushed as the rule on standstill needs it: a push that is clipped proves nothing."""

from math import ceil, sqrt

import numpy as np

from hil.app.configuration.configuration import Configuration
from hil.app.encoder_limits import AWAY, efficiencies, friction_N, stated_friction_N
from hil.app.reachability import Walk, window_swing
from hil.safety.encoder_limits import EncoderLimits
from hil.safety.guard import WINDOW_S
from hil.safety.residuals import MOVED


def clipped(c: Configuration, limits: EncoderLimits, w: Walk) -> str | None:
    """Return what clips a push on the way along a reference, or what it does to a free leg; None: nothing.

    A push acts on top of the path's force, where there is no friction both ways. Where there is, it comes at
    once: a leg that is free is pushed until its motion is seen, after a time t, and the law takes as long to
    stop it: it moves by up to push A t^2.
    """
    if limits.watched_legs == 0:
        return None
    A, late_s = np.diag(limits.mobility) / AWAY, limits.acting_ticks * limits.period_s
    following_m = c.limits.following_error_m
    beside_m = max(sqrt(following_m) - sqrt(2.0 * MOVED * limits.length_noise_m), 0.0)
    ticks = ceil(WINDOW_S / (w.t[1] - w.t[0])) if len(w.t) > 1 else 1
    force, window = c.limits.force_N, c.limits.force_window_N
    ways, both = (1.0, "") if limits.sticks else (2.0, " both ways")
    peak, swing = np.abs(w.tau).max(axis=0), window_swing(w.tau, ticks).max(axis=0)
    room = {
        f"limits.force_N {force:g}, of which the path takes {peak.max():.0f} N": force - peak,
        f"limits.force_window_N {window:g}{both}, of which the path takes {swing.max():.0f} N": (
            (window - swing) / ways
        ),
    }
    if limits.sticks:
        moves = "as a free leg moves until that is seen beside monitor.length_noise_m"
        room[f"limits.following_error_m {following_m:g}, {moves}"] = (beside_m / late_s) ** 2 / A
    room = {what: most for what, most in room.items() if (most >= 0.0).all()}  # else the path breaks it alone
    if all((most >= limits.push_N).all() for most in room.values()):
        return None
    what, least = min(room.items(), key=lambda each: float((each[1] - limits.push_N).min()))
    beyond = least - limits.push_N
    leg = int(np.argmin(beyond))
    friction = friction_N(c)
    driving, back_driving = efficiencies(c)
    most = friction + float(beyond[leg] / (1.0 / driving[leg] + back_driving[leg]))
    losses = " and losses" if (driving * back_driving < 1.0).any() else ""
    key = what.split()[0]
    return (
        f"a leg that stands still is pushed by {limits.push_N[leg]:.0f} N, 2 x friction{losses} and what "
        f"monitor.disturbance_m_s2 asks for; that is too much for {what}, allowed: "
        f"{f'at most {most:.1f} N' if most >= 0.0 else 'no such push'}, given: {friction:g} N"
        f"{' (assumed)' if friction > stated_friction_N(c) else ''}; state the friction as measured, "
        f"or raise {key}"
    )
