"""The checklist of a bring-up: what was measured of each leg, by step, as lines."""

from collections.abc import Iterable
from typing import Any

from drivers.signals import LEGS
from hil.lab.bringup.context import Context
from hil.lab.bringup.procedure import STEPS, Outcome
from hil.lab.bringup.steps.gauge import WITHIN, gains


def checklist(c: Context, outcome: Outcome, together: Iterable[str]) -> list[str]:
    """Return the lines: a line a step with its verdict, below it the figures of each leg."""
    lines = []
    done, gaps = set(outcome.passed), dict(outcome.gaps)
    for step in STEPS:
        figures = _figures(c, step.name)
        mark = "x" if step.name in done else "!" if figures and outcome.findings else " "
        mark = "-" if step.name in gaps else mark
        lines.append(f"[{mark}] {step.name}: {step.title}")
        lines += [f"      {line}" for line in figures]
        if step.name in gaps:
            lines.append(f"      {gaps[step.name].line}; taken over by the operator")
    lines += [f"    ! {finding.line}" for finding in outcome.findings]
    lines += list(together)
    return lines


def _figures(c: Context, step: str) -> list[str]:
    if step == "mounted":
        poses = sorted(c.facts.get("mounted", {}).items())
        mass = c.facts.get("load", {}).get("mass_kg")
        load = [] if not mass else [f"weighs {mass:.4g} kg, configured are {c.machine.platform_kg:.4g} kg"]
        return load + [
            f"pose {pose}: legs {', '.join(f'{q:.4f}' for q in fact['q_m'])} m" for pose, fact in poses
        ]
    return [f"leg {leg}: {text}" for leg in range(LEGS) if (text := _of_leg(c, step, leg))]


def _of_leg(c: Context, step: str, leg: int) -> str:
    fact = c.known({"brakes": "opens"}.get(step, step), leg)
    if fact is None:
        return ""
    match step:
        case "scan":
            heard = f"node {c.machine.node_ids[leg]} answers {100 * fact['answers']:.0f} % of the polls"
            said = "".join(f", {what} {n}" for what, n in (c.known("identity", leg) or {}).items())
            return (
                f"{heard}, {c.machine.protocol}{said}, {fact['state']}; {fact['lacks'] or 'set-up confirmed'}"
            )
        case "watchdog":
            since, until = fact["since_s"], fact["until_s"]
            set_ms = 1e3 * c.machine.watchdog_s
            if until is None:
                return f"no reaction, set {set_ms:g} ms"
            return (
                f"reacts {1e3 * (since or 0.0):.4g} to {1e3 * until:.4g} ms after silence, set {set_ms:g} ms"
            )
        case "ids":
            return f"counted by drive {', '.join(map(str, fact['drives'])) or 'none'}"
        case "encoder":
            low, high = fact["tape_m"]
            return (
                f"{low:.4f} to {high:.4f} m by tape; reads {fact['scale']:.5f} m a m, "
                f"{1e3 * fact['offset_m']:+.2f} mm"
            )
        case "brakes":
            gives = ", ".join(map(str, fact["legs"])) or "none"
            at = "" if fact["hand_N"] is None else f" at {fact['hand_N']:.4g} N"
            held = c.known("held", leg)
            shut = "" if held is None else "; shut: " + _shut(held)
            share = fact["rate_share"]
            rate = "" if share is None else f"; its rate is {share:.2f} of what its reading changes by"
            return f"its drive's brake frees leg {gives}{at}{shut}{rate}"
        case "force":
            parts = (f"{way} {_force(fact[way])}" for way in ("plus", "minus"))
            return "; ".join(parts)
        case "gauge":
            g = gains(c).get(leg)
            if g is None:
                return ""
            within = WITHIN + g.error + c.machine.losses
            return f"{g.value:.3f} N a commanded N; what is right is within {100.0 * within:.2g} % of 1"
    return ""


def _shut(held: dict[str, Any]) -> str:
    return "gives way" if held["moved"] else f"holds {held['hand_N']:.4g} N by hand"


def _force(found: dict[str, float | None]) -> str:
    if found["force_N"] is None:
        return "does not move"
    return f"{found['force_N']:.4g} N moves leg {found['leg']} {'longer' if found['way'] == 1 else 'shorter'}"
