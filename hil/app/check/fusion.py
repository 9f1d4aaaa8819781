"""The part of `hil check` that says what the fused pose believes of the legs, and what nobody has stated."""

from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.leg_errors import leg_errors
from plant_fmu.config import FmuPlant

KNOWS_NOTHING = "none: the model is taken at its word; an unknown force leaves good legs out"


def report_fusion(report: Report, c: Configuration) -> None:
    """Print standard deviations of lengths, rates and unknown forces, where the pose is fused."""
    if c.estimation.pose != "fused":
        return
    errors = leg_errors(c)
    skew_us, scale_percent = 1e6 * errors.rate_skew_std_s, 1e2 * errors.rate_scale_std
    rates = f"{1e3 * errors.rate_std_m_s:.3g} mm/s, {skew_us:.3g} us of the acceleration"
    rates += f", {scale_percent:.2g} % of the rate"
    forces = f"{errors.force_std_N:g} N over {1e3 * errors.force_time_s:g} ms{_source(c)}"
    report.sections["fused pose, standard deviations"] = [
        f"leg lengths    {1e6 * errors.length_std_m:.3g} um",
        f"leg rates      {rates}",
        f"unknown forces {forces if errors.force_std_N > 0.0 else KNOWS_NOTHING}",
    ]
    report.figures["fusion"] = errors._asdict()


def _source(c: Configuration) -> str:
    unstated = c.estimation.fusion.leg_force_std_N is None and c.monitor.friction_N is None
    if unstated and (c.plant is None or isinstance(c.plant.model, FmuPlant)):
        return " (assumed); state monitor.friction_N or estimation.fusion.leg_force_std_N as measured"
    return ""
