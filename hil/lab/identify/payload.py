"""`hil identify payload`: masses, inertia and friction of a platform from logs of ordinary runs."""

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import HilError, IdentificationError
from drivers.files import real_path
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, platform_body
from hil.app.loop_delay import LoopDelay, loop_delay
from hil.config.model import ModelSettings
from hil.config.platform import PayloadSettings
from hil.control.model import build_model
from hil.lab.identify.estimators.body_fit import (
    Consistent,
    Estimate,
    consistent,
    halves,
    prediction_error,
    solve,
    unknowns_scale,
)
from hil.lab.identify.estimators.force_delay import mean_forces
from hil.lab.identify.estimators.leg_equations import (
    COLUMNS,
    COULOMB,
    REFLECTED,
    VISCOUS,
    Equations,
    equations_of,
    joined,
    without,
)
from hil.lab.identify.estimators.leg_motion import LegSignals
from hil.lab.identify.estimators.rigid_body import SIZE, parameters_of
from hil.lab.identify.runs import at_ticks, brakes_open, episode, recorded_run, refuse_fused
from hil.robot.dynamics import Model

SURE = 3.0
"""Standard errors beyond which a difference is significant."""
LEAST_PAYLOAD = 2e-3
"""Least payload, as a share of the platform's mass; less is an error of the platform's data."""
HIDDEN = 0.1
"""Share of an unknown in hidden directions above which it is reported as not shown."""
WRONG = 0.3
"""Residual, as a share of the leg forces, above which the result is refused."""
HALVES = ("first half", "second half")
DRIVES = {
    "viscous_friction_N_s_m": (VISCOUS, "viscous friction", "N s/m"),
    "coulomb_friction_N": (COULOMB, "Coulomb friction", "N"),
    "reflected_mass_kg": (REFLECTED, "reflected mass", "kg"),
}
"""First columns of the drives' parameters, with name and unit, by key in `controller.model`."""


class Source(NamedTuple):
    """One log as leg equations, with its configuration and model."""

    path: Path
    configuration: Configuration
    model: Model
    equations: Equations
    sent: tuple[float, LoopDelay] | None
    """Rate in Hz and delay of sent forces; None if the drives report their forces."""
    seconds: float
    """Time with open brakes, s."""


class Found(NamedTuple):
    """Identified parameters of platform, payload and drives."""

    sources: list[Source]
    believed: Array
    """(29,) configured values, without `inertia_scale`."""
    carrier: Array
    """(10,): configured body without the payload that is given by ranges."""
    estimate: Estimate
    whole: Consistent
    """Body of the platform with its whole load."""
    payload: Consistent | None
    """Platform and a payload that is a body by itself; None if there is no unknown payload."""
    reflected_kg: float | None
    """Reflected motor mass of each leg, kg, if the user gave it."""
    rms_believed_N: float
    rms_force_N: float
    """Rms, N, of the leg forces less the forces that the legs need for themselves."""
    held_out: dict[str, tuple[float, float]]
    """By log, or half of the log: rms in N with a fit to the others, and with the configured values."""

    @property
    def split(self) -> bool:
        """True if the mass beyond the configured platform is reported as a payload of its own."""
        return self.payload is not None and self.payload.shift <= SURE

    @property
    def theta(self) -> Array:
        """Identified parameters (29,): body (10), viscous and Coulomb friction, delay, reflected mass."""
        return self.payload.theta if self.payload is not None and self.split else self.whole.theta


def identify_payload(paths: list[Path], reflected_kg: float | None = None) -> Found:
    """Identify masses, inertia and friction from logs of `hil run` or `hil sim`.

    reflected_kg: motor mass along each leg, if known. Raises LogError for another file, ConfigurationError
    for a fused pose, IdentificationError for too little data or logs of different platforms.
    """
    if len({real_path(path) for path in paths}) < len(paths):
        raise IdentificationError(
            "the same log is given twice, allowed: each log once; a repeated log confirms itself"
        )
    sources = [_source(path) for path in paths]
    first = sources[0]
    for other in sources[1:]:
        for what, here, there in (
            ("section platform", other.configuration.platform, first.configuration.platform),
            ("kind, rate or delay of forces", other.sent, first.sent),
        ):
            if here != there:
                raise IdentificationError(
                    f"{other.path}: its {what} differs from {first.path}: identify each log alone"
                )
    platform = first.model.platform
    believed, scale = _believed(first), unknowns_scale(platform)
    if reflected_kg is not None:
        believed[REFLECTED:] = reflected_kg
        sources = [s._replace(equations=without(s.equations, believed, REFLECTED)) for s in sources]
    together = joined([s.equations for s in sources])
    logs = ", ".join(str(s.path) for s in sources)
    try:
        estimate = solve(together, believed, scale)
    except IdentificationError as error:
        raise IdentificationError(f"{logs}: {error}") from None
    rms = prediction_error(together, believed), prediction_error(together, np.zeros(COLUMNS))
    left = float(np.sqrt(np.mean(estimate.residual_N**2))) / rms[1]
    if left > WRONG or not estimate.theta[0] > 0.0:
        raise IdentificationError(
            f"{logs}: a platform of {estimate.theta[0]:.4g} kg leaves {100.0 * left:.0f} % of the leg forces "
            f"unexplained, allowed: a mass > 0 and {100.0 * WRONG:g} %; another robot, or an external force"
        )
    carrier = _carrier(first)
    more = float(estimate.theta[0] - carrier[0])
    carried = more > max(SURE * float(estimate.std[0]), LEAST_PAYLOAD * carrier[0])
    whole = consistent(estimate, platform.radius)
    payload = consistent(estimate, platform.radius, carrier) if carried else None
    held_out = _held_out(sources, believed, scale)
    return Found(sources, believed, carrier, estimate, whole, payload, reflected_kg, *rms, held_out)


def _source(path: Path) -> Source:
    recorded = recorded_run(path)
    refuse_fused(recorded.configuration, path)
    c, period = recorded.configuration, 1.0 / recorded.rate_Hz
    # the robot of section `platform`, to its figures: its legs and joints count
    sliding_m_s = (c.controller.believed or ModelSettings()).sliding_speed_m_s
    exact = ModelSettings(sliding_speed_m_s=sliding_m_s)
    model = build_model(exact, build_platform(c.platform), c.platform.leg_spin)
    try:
        brakes_open(recorded.rows)
        rows, p, R, good = episode(recorded.rows)
        running = brakes_open(rows)
        sent = None if rows["drive_force"].any() else (recorded.rate_Hz, loop_delay(c))
        force = np.asarray(rows["drive_force"], np.float64)
        if sent is not None:
            delay = sent[1]
            mean = mean_forces(np.ascontiguousarray(rows["tau"]), period, delay.transport_s, delay.lag_s)
            # of the periods before and after each tick
            force = 0.5 * (np.vstack([mean[:1], mean]) + np.vstack([mean, mean[-1:]]))
        length, reference = (np.ascontiguousarray(rows[name]) for name in ("q", "q_d"))
        good = good & running & np.isfinite(force + reference).all(axis=1)
        cells = None if c.sensors.forces is None else at_ticks(rows, "force_sensor", period)
        if cells is not None:
            good &= np.isfinite(cells).all(axis=1)
        signals = LegSignals(period, length, reference, force, p, R, good, cells)
        equations = equations_of(model, signals)
    except HilError as error:
        raise type(error)(f"{path}: {error}") from None
    return Source(path, c, model, equations, sent, float(running.sum()) * period)


def _believed(source: Source) -> Array:
    """Configured values (29,) of section platform and `controller.model`, without `inertia_scale`."""
    b = source.configuration.controller.believed
    theta = np.zeros(COLUMNS)
    theta[:SIZE] = parameters_of(source.model.platform.platform)
    for key, (at, *_) in DRIVES.items():
        if b is not None:
            theta[at : at + 6] = getattr(b, key)
    return theta


def ranged_body(c: Configuration) -> PayloadSettings | None:
    """The configured payload whose mass and place are given by ranges; None without."""
    return next((body for body in c.platform.platform.payload if body.ranged), None)


def _carrier(source: Source) -> Array:
    """Body parameters (10,) of the platform without the payload that is given by ranges."""
    settings = source.configuration.platform
    fixed = [body for body in settings.platform.payload if not body.ranged]
    bare = settings.platform.model_copy(update={"payload": fixed})
    return parameters_of(platform_body(settings.model_copy(update={"platform": bare})))


def _held_out(sources: list[Source], believed: Array, scale: Array) -> dict[str, tuple[float, float]]:
    """Rms error, N, of each log, or half of the only log, with a fit to the others and as configured."""
    parts = {str(s.path): s.equations for s in sources}
    if len(sources) == 1:
        parts = dict(zip(HALVES, halves(sources[0].equations), strict=True))
    found = {}
    for name, part in parts.items():
        with suppress(IdentificationError):
            fit = solve(joined([other for each, other in parts.items() if each != name]), believed, scale)
            if len(part.y):
                found[name] = prediction_error(part, fit.theta), prediction_error(part, believed)
    return found


def drives_of(found: Found) -> dict[str, tuple[Array, Array]]:
    """{key of `controller.model`: (values (6,), standard errors (6,))}; no reflected masses if given."""
    std, given = found.estimate.std, found.reflected_kg is not None
    parts = {key: at for key, (at, *_) in DRIVES.items() if at != REFLECTED or not given}
    return {key: (found.theta[at : at + 6], std[at : at + 6]) for key, at in parts.items()}
