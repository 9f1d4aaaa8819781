"""What the rows of motor protocols take of a configuration, and which torque a leg needs of its motor."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.motor_settings import Options, refuse_torque
from drivers.transmission import Transmission


def options(*known: str, **given: Any) -> Options:
    drives = DriveSettings(transmission=TransmissionSettings(lead_m=0.5), options={})
    return Options(BusSettings(), drives.model_copy(update={"options": given}), "kite", "fd", known)


@pytest.mark.parametrize(
    ("take", "given", "message"),
    [
        (lambda _: None, {"c": 1, "d": 3}, "has a, given: c, d"),
        (lambda o: o.choice("a", ("x", "y")), {}, "one of x, y, given: nothing"),
        (lambda o: o.choice("a", ("x", "y")), {"a": "z"}, "one of x, y, given: z"),
        *(
            (lambda o: o.positive("a", 1.0), {"a": a}, f"given: {a}")
            for a in (0, -1.0, True, "2", float("nan"))
        ),
        *((lambda o: o.whole("a", 1), {"a": a}, f"given: {a}") for a in (True, 2.0, "2")),
    ],
)
def test_option_that_does_not_fit_is_refused_by_name(take, given, message):
    with pytest.raises(ConfigurationError, match=rf"^drives\.options: .*{message}$"):
        take(options("a", **given))


@pytest.mark.parametrize("leg", range(6))
def test_leg_that_needs_most_torque_decides_and_is_named_where_legs_are_unlike(leg):
    # F l / (2 pi eta): 100 N x 0.2 m / (2 pi 0.8) = 3.979 N m
    leads = [0.2 if each == leg else 0.1 for each in range(6)]
    unlike = Transmission(TransmissionSettings(lead_m=leads, efficiency=0.8, sign=[1, -1, 1, -1, 1, -1]))
    refuse_torque(unlike, 100.0, 3.98, "kite")
    with pytest.raises(
        ConfigurationError, match=rf"100 N need 3\.979 N m of the motor of leg {leg} .* 3\.97 N m"
    ):
        refuse_torque(unlike, 100.0, 3.97, "kite")
    alike = Transmission(TransmissionSettings(lead_m=0.2, efficiency=0.8))
    with pytest.raises(ConfigurationError, match=r"100 N need 3\.979 N m of the motor \("):
        refuse_torque(alike, 100.0, 3.97, "kite")


def test_force_that_needs_just_the_torque_of_the_field_is_taken():
    unit = Transmission(TransmissionSettings(lead_m=1.0))
    needed = float((100.0 / unit.N_per_Nm)[0])
    refuse_torque(unit, 100.0, needed, "kite")
    with pytest.raises(ConfigurationError):
        refuse_torque(unit, 100.0, needed * (1 - 1e-12), "kite")
