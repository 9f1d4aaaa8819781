"""`hil stability CONFIG`: provable stability of the configured control law, with figures and conditions."""

from collections.abc import Callable
from typing import Any

from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_of
from hil.app.configuration.payload_box import shown_ranges
from hil.app.stability import axes, boundary_layer, springs
from hil.app.stability.assessment import Assessment
from hil.app.stability.subject import NO_PAYLOAD, Payload, Stated, Subject
from hil.app.stability.timing import timed
from hil.config.reference import HoldReference
from hil.design.stability.disturbance import Load
from plant_fmu.config import BenchPlant

SPRINGS = ("pd", "pid", "pd_gravity", "cartesian_pd", "feedforward_pd")
"""Laws judged for one robot at a time; listed by name, as a user's law may inherit from their settings."""


def judge(
    c: Configuration, stated: Stated | None = None, tell: Callable[[float, float], None] = lambda *_: None
) -> Assessment:
    """Result of the stability proof for a configuration's law.

    tell: progress callback, called with checked and total seconds of the reference. Raises
    ConfigurationError: the reference cannot be followed.
    """
    stated = Stated() if stated is None else stated
    return timed(c, _judge(c, stated, tell))


def loop_at_home(c: Configuration) -> tuple[float | None, float | None]:
    """Crossover, rad/s, and delay margin, ms, of the loop that runs, for small errors at home.

    None: unlimited, unknown, or the loop is unstable. Raises ConfigurationError.
    """
    sampled = at_home(c).figures.get("sampled", {})
    return sampled.get("cross_over_rad_s"), sampled.get("delay_margin_ms")


def at_home(c: Configuration, stated: Stated | None = None) -> Assessment:
    """Result of the stability proof for a reference that holds home. Raises ConfigurationError."""
    return judge(c.model_copy(update={"reference": HoldReference(type="hold")}), stated)


def _judge(c: Configuration, stated: Stated, tell: Callable[[float, float], None]) -> Assessment:
    subject = Subject(c, stated, tell)
    law: Any = c.controller
    if c.plant is not None and isinstance(c.plant.model, BenchPlant):
        if stated.payload.mass_kg:
            return Assessment("not proven", "six uncoupled legs carry no payload", [], [], {})
        if law.law == "pd":
            return springs.bench(subject, law, c.plant.model)
        claim = "six uncoupled legs are not the robot of this law's model"
        return Assessment("not proven", claim, [], [], {})
    if law.law in SPRINGS:
        return springs.springs(subject, law)
    if law.law == "state_space":
        controller = controller_of(law, c.folder)
        assert controller is not None
        return axes.designed(subject, controller, law.model, axes.assumed(subject, law))
    if law.law in {"sliding_mode", "robust_inverse_dynamics"}:
        return boundary_layer.robust(subject, law)
    dynamics = law.error_dynamics()
    if isinstance(dynamics, str):
        return Assessment("not proven", dynamics, [], [], {})
    if law.believed is None or dynamics.steepness > 0.0:
        return Assessment("not proven", "no theorem used here covers its error dynamics", [], [], {})
    return axes.linear(subject, law, dynamics)


def assess(
    c: Configuration,
    *,
    force_N: float = 0.0,
    torque_N_m: float = 0.0,
    model_error: float = 0.0,
    payload: Payload = NO_PAYLOAD,
) -> dict[str, Any]:
    """Summary of `hil stability`; `success` is True for a proof, even a conditional one.

    force_N, torque_N_m: unknown load; model_error: relative error of masses. Raises ConfigurationError.
    """
    found = judge(c, Stated(Load(force_N, torque_N_m), model_error, payload))
    ridden = [shown_ranges(body) for body in c.platform.platform.payload if body.ranged]
    return {
        "success": found.status in {"proven", "conditional"},
        "kind": "stability",
        "configuration": c.source,
        "law": c.controller.law,
        "stated": {
            "force_N": force_N,
            "torque_N_m": torque_N_m,
            "model_error": model_error,
            "payload_kg": payload.mass_kg,
            "payload_at_m": list(payload.at_m),
            "payload_ranges": "".join(ridden),
        },
        "status": found.status,
        "claim": found.claim,
        "conditions": found.conditions,
        "premises": found.premises,
        "lines": found.lines,
        "figures": found.figures,
    }


def shown(summary: dict[str, Any]) -> list[str]:
    """Summary of `hil stability` as lines of text."""
    stated = summary["stated"]
    lines = [f"law {summary['law']}", f"status         {summary['status']}: {summary['claim']}"]
    lines += [f"  if           {condition}" for condition in summary["conditions"]]
    if stated["payload_kg"]:
        x, y, z = stated["payload_at_m"]
        lines.append(
            f"payload        {stated['payload_kg']:g} kg at ({x:g}, {y:g}, {z:g}) m of the platform or none, "
            "not in the law's model"
        )
    if stated["payload_ranges"]:
        lines.append(f"payload box    {stated['payload_ranges']}: the model's own, and each corner")
    if stated["force_N"] or stated["torque_N_m"] or stated["model_error"]:
        lines.append(
            f"unknown load   {stated['force_N']:g} N and {stated['torque_N_m']:g} N m in any direction, "
            f"masses {100 * stated['model_error']:g} % wrong"
        )
    return [*lines, *summary["lines"]]
