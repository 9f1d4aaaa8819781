"""The checklist of a bring-up: what was measured of each leg, by step, as lines."""

from collections.abc import Iterable

from drivers.signals import LEGS
from hil.lab.bringup.context import Context
from hil.lab.bringup.procedure import STEPS, Outcome
from hil.lab.bringup.steps.gauge import WITHIN, gains


def checklist(c: Context, outcome: Outcome, together: Iterable[str]) -> list[str]:
    """Return the lines: a line a step with its verdict, below it the figures of each leg."""
    lines, gaps = [], dict(outcome.gaps)
    for step in STEPS:
        figures, gap = _figures(c, step.name), gaps.get(step.name)
        mark = "x" if step.name in outcome.passed else "!" if figures and outcome.findings else " "
        lines.append(f"[{'-' if gap else mark}] {step.name}: {step.title}")
        if gap:
            figures.append(f"{gap.line}; taken over by the operator")
        lines += [f"      {line}" for line in figures]
    return [*lines, *(f"    ! {finding.line}" for finding in outcome.findings), *together]


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
            since_ms, until = 1e3 * (fact["since_s"] or 0.0), fact["until_s"]
            reacts = (
                "no reaction" if until is None else f"reacts {since_ms:.4g} to {1e3 * until:.4g} ms after"
            )
            return f"{reacts}, set {1e3 * c.machine.watchdog_s:g} ms"
        case "ids":
            return f"counted by drive {', '.join(map(str, fact['drives'])) or 'none'}"
        case "encoder":
            low, high = fact["tape_m"]
            return (
                f"{low:.4f} to {high:.4f} m by tape; reads {fact['scale']:.5f} m a m, "
                f"{1e3 * fact['offset_m']:+.2f} mm"
            )
        case "brakes":
            text = f"its drive's brake frees leg {', '.join(map(str, fact['legs'])) or 'none'}"
            if fact["hand_N"] is not None:
                text += f" at {fact['hand_N']:.4g} N"
            if (held := c.known("held", leg)) is not None:
                text += "; shut: " + ("gives way" if held["moved"] else f"holds {held['hand_N']:.4g} N")
            if fact["rate_share"] is not None:
                text += f"; its rate is {fact['rate_share']:.2f} of what its reading changes by"
            return text
        case "force":
            return "; ".join(f"{way} {_force(fact[way])}" for way in ("plus", "minus"))
        case "gauge":
            g = gains(c).get(leg)
            if g is None:
                return ""
            within = WITHIN + g.error + c.machine.losses
            return f"{g.value:.3f} N a commanded N; what is right is within {100.0 * within:.2g} % of 1"
    return ""


def _force(found: dict[str, float | None]) -> str:
    if found["force_N"] is None:
        return "does not move"
    return f"{found['force_N']:.4g} N moves leg {found['leg']} {'longer' if found['way'] == 1 else 'shorter'}"
