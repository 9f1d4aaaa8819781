"""Whether the steps of a torque field are fine enough for the robot of `hil new`, at its gains and limits."""

from typing import Any

import numpy as np

from hil.app.force_steps import error_m
from hil.app.new import derive, drives
from hil.app.new.robot import robot_at_home

ROOM = 1.01
"""The file has its numbers rounded."""


def travel_trouble(a: dict[str, Any]) -> str | None:
    """Return why a leg length a turn suits neither stroke, torque nor the following error; None: it does."""
    return drives.travel_trouble(a, _finest_m(a, None))


def rate_trouble(a: dict[str, Any]) -> str | None:
    """Return why the gains of a rate are too soft for the steps of the force; None where they are not."""
    finest_m = _finest_m(a, a["rate_Hz"])
    if not drives.bought(a) or a["travel_m"] >= finest_m:
        return None
    return (
        f"at {a['rate_Hz']:g} Hz one code of torque is {drives.force_step_N(a, a['travel_m']):.2g} N at the "
        f"leg and leaves it beyond 2 % of the stroke from its reference: take a higher rate, or --travel "
        f"of at least {finest_m:.4g} m a turn"
    )


def _finest_m(a: dict[str, Any], rate_Hz: float | None) -> float:
    """Return the least leg length a turn whose step of force stays within the following error, m.

    A step is a torque over that length. At a rate in Hz; None: at the highest that the bus carries.
    """
    if not drives.models(a):
        return 0.0
    if rate_Hz is None:
        assumed = {
            "layout": drives.family(a).layout,
            "channels": "1",
            **a,
            "travel_m": drives.travels_m(a)[1],
        }
        rate_Hz = derive.loop_rate_Hz(assumed, slow=a.get("slow_plant", False))
    home = robot_at_home(a)
    P = home.J @ np.linalg.solve(home.model.mass_matrix(*home.pose), home.J.T)
    at_a_metre = error_m(P, np.full(6, drives.force_step_N(a, 1.0)), derive.wn_rad_s(rate_Hz) ** 2)
    return ROOM * at_a_metre / derive.following_error_m(a)
