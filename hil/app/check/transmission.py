"""What `hil check` says of the way from motor to leg: what to compare with the machine before it moves."""

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from drivers.transmission import Transmission
from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration

_HEAD = "leg  mm/turn    turns at the ends   N/N m   rpm N m held   rated"


def report_transmission(report: Report, c: Configuration, holding_N: Array) -> None:
    """Say of each leg what its motor reads, turns and gives; nothing where the drives speak of legs.

    holding_N (6,): leg forces that hold the platform at home. A line of several legs holds for each of them.
    """
    if c.drives.transmission is None:
        return
    gear, s = Transmission(c.drives.transmission), c.platform
    ends = [gear.turns(np.full(LEGS, q)) for q in (s.length_min_m, s.length_max_m)]
    rpm = 60.0 * c.limits.speed_m_s / np.abs(gear.m_per_turn)
    held, rated = gear.torque(holding_N), np.abs(c.drives.force_limit_N / gear.N_per_Nm / gear.driving)
    rows = [
        f"{1e3 * gear.m_per_turn[i]:+7.4g} {ends[0][i]:+8.4g} to {ends[1][i]:+8.4g} "
        f"{abs(gear.N_per_Nm[i]):7.4g} {rpm[i]:5.0f} {held[i]:+8.4f} {rated[i]:7.4f}"
        for i in range(LEGS)
    ]
    legs = {row: [i for i in range(LEGS) if rows[i] == row] for row in rows}
    report.sections["motor to leg"] = [
        _HEAD,
        *(f"{_named(of):4}{row}" for row, of in legs.items()),
        "turns as the drive reports them, > 0 lengthens the leg; ends retracted,",
        "extended; rpm at limits.speed_m_s; N m that hold the platform at home,",
        "without losses, and that drives.force_limit_N takes, with losses",
    ]
    report.figures["transmission"] = {
        "m_per_turn": gear.m_per_turn.tolist(),
        "turns_retracted": ends[0].tolist(),
        "turns_extended": ends[1].tolist(),
        "N_per_Nm": gear.N_per_Nm.tolist(),
        "rpm": rpm.tolist(),
        "holding_Nm": held.tolist(),
        "rated_Nm": rated.tolist(),
    }


def _named(legs: list[int]) -> str:
    return "all" if len(legs) == LEGS else ",".join(map(str, legs))
