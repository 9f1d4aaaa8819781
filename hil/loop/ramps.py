"""How the force comes and goes: between nothing, what holds the platform, and the law's own."""

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import helper
from drivers.signals import Mode
from drivers.tick_columns import Record, copy_of
from hil.control.law import Law
from hil.loop.reference import fill_reference
from hil.robot.geometry import Platform
from hil.trajectory.path import PoseSample

_LOADING = int(Mode.LOADING)


@helper
def smoothstep(x: float) -> float:
    """Return 10 x^3 - 15 x^4 + 6 x^5 of x clamped to 0 .. 1; both ends are at rest."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


@helper
def holding_share(mode: int, elapsed_s: float, load_s: float) -> float:
    """Return the share of the holding force in LOADING and UNLOADING, where both take `load_s` > 0 for it.

    LOADING begins with a brake test, as long without any.
    """
    if mode == _LOADING:
        return smoothstep((elapsed_s - load_s) / load_s)
    return 1.0 - smoothstep(elapsed_s / load_s)


def tau_at_rest(law: Law, platform: Platform, tick: Record, sample: PoseSample, *, on_it: bool) -> Array:
    """Return what the law asks for at rest, without load, its reference being the sample; the law is reset.

    on_it: as if the platform were there, too; otherwise it is where it was measured in this tick.
    """
    at_rest = copy_of(tick)
    at_rest["wrench"] = 0.0
    fill_reference(platform, sample, at_rest)
    if on_it:
        for name in ("q", "p", "R"):
            at_rest[name] = at_rest[name + "_d"]
        at_rest["dq"] = at_rest["twist"] = ZERO6
    law.reset()
    law.effort(at_rest)
    law.reset()
    return at_rest["tau_law"]
