"""Which values the section `plant` and its faults take: both ends of each range, and what is mapped to an FMU."""

from __future__ import annotations

from math import inf, nextafter
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from plant_fmu import config
from plant_fmu.faults import FAULTS
from tests.plant_fmu.test_faults import example
from tests.plant_fmu.test_section_defaults import DEFAULTS, FMU

Border = tuple[float | None, float | None]
"""What is allowed at this end of a range, and what is just beyond it; None: there is no end."""
NONE: Border = (None, None)
TINY = 1e-12


def least(value: float) -> Border:
    return value, value - 1 if isinstance(value, int) else nextafter(value, -inf)


def most(value: float) -> Border:
    return value, value + 1 if isinstance(value, int) else nextafter(value, inf)


FROM_0, ABOVE_0, INTEGER_FROM_0 = least(0.0), (TINY, 0.0), least(0)
SECTIONS: dict[str, dict[str, tuple[Border, Border]]] = {
    "drives": {
        **dict.fromkeys(
            ("encoder_resolution_m", "damping_N_s_m", "hold_stiffness_N_m", "force_bandwidth_Hz"),
            (FROM_0, NONE),
        ),
        **dict.fromkeys(("brake_open_ms", "brake_close_ms"), (FROM_0, most(10_000.0))),
    },
    "stewart": {
        "internal_step_us": (ABOVE_0, NONE),
        **dict.fromkeys(
            (
                *("force_bandwidth_Hz", "viscous_friction_N_s_m", "coulomb_friction_N"),
                *("reflected_mass_kg", "brake_force_N"),
            ),
            (FROM_0, NONE),
        ),
    },
    "bench": {
        **dict.fromkeys(("mass_kg", "rest_length_m", "internal_step_us"), (ABOVE_0, NONE)),
        **dict.fromkeys(("damping_N_s2_m2", "stiffness_N_m", "stiffness_N_m3"), (FROM_0, NONE)),
    },
    "fmu": {"memory_GB": (least(0.25), most(1024.0)), "step_us": (ABOVE_0, NONE)},
    "tracker": {
        "latency_ms": (FROM_0, most(60.0)),
        "lost_percent": (FROM_0, most(100.0)),
        **dict.fromkeys(("position_noise_m", "orientation_noise_deg"), (FROM_0, NONE)),
    },
    "imu": {
        "latency_ms": (FROM_0, most(60.0)),
        **dict.fromkeys(("angular_rate_noise_rad_s", "specific_force_noise_m_s2"), (FROM_0, NONE)),
    },
    "wrench": {
        "latency_ms": (FROM_0, most(60.0)),
        **dict.fromkeys(("force_noise_N", "moment_noise_N_m"), (FROM_0, NONE)),
    },
    "sensors": {"seed": (INTEGER_FROM_0, NONE)},
}
OF_FAULTS: dict[str, dict[str, tuple[Border, Border]]] = {
    "encoder_noise": {"sigma_m": (FROM_0, NONE), "seed": (INTEGER_FROM_0, NONE)},
    "encoder_late": {"by_ms": (ABOVE_0, most(1000.0))},
    "drive_reset": {},
    "drive_saturation": {"limit_N": (FROM_0, NONE)},
    "brake_slow": {"by_ms": (ABOVE_0, most(10_000.0))},
    "brake_slipping": {"share": (FROM_0, most(1.0))},
    "frames_loss": {
        "probability": (FROM_0, most(1.0)),
        "identifier": (INTEGER_FROM_0, NONE),
        "seed": (INTEGER_FROM_0, NONE),
    },
    "frames_delay": {"by_ms": (ABOVE_0, most(1000.0))},
    "frames_old": {"back": (least(1), most(1000))},
    "bus_off": {"bus": (INTEGER_FROM_0, most(5))},
    "bus_flood": {"rate_Hz": (ABOVE_0, most(100_000.0)), "identifier": (INTEGER_FROM_0, most(0x7FF))},
    "bus_second_controller": {"rate_Hz": (ABOVE_0, most(100_000.0)), "bus": (INTEGER_FROM_0, most(5))},
    "process_stop": {"for_s": (ABOVE_0, most(3600.0))},
    "process_slow": {"by_ms": (ABOVE_0, most(1000.0))},
    "payload_step": {"mass_kg": (ABOVE_0, NONE)},
}
"""Beside the time, the length and the leg of each."""


def allowed(of: BaseModel, key: str, value: object) -> bool:
    try:
        type(of).model_validate({**of.model_dump(), key: value})
    except ValidationError:
        return False
    return True


def ends_where_stated(of: BaseModel, ranges: dict[str, tuple[Border, Border]]) -> None:
    for key, ends in ranges.items():
        for inside, beyond in ends:
            assert inside is None or allowed(of, key, inside), (key, inside)
            assert beyond is None or not allowed(of, key, beyond), (key, beyond)


@pytest.mark.parametrize("name", SECTIONS)
def test_a_section_takes_what_is_within_its_ranges_and_both_their_ends(name):
    section = config.SensorEmulation() if name == "sensors" else DEFAULTS[name][0]
    ends_where_stated(section, SECTIONS[name])


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_takes_what_is_within_its_ranges_and_both_their_ends(name):
    fault = example(name)
    ranges = {"at_s": (FROM_0, NONE), **OF_FAULTS.get(name, {})}
    has = type(fault).model_fields
    ranges |= {"leg": (INTEGER_FROM_0, most(5))} if "leg" in has else {}
    ranges |= {"for_s": (ABOVE_0, NONE)} if "for_s" in has and name != "process_stop" else {}
    ends_where_stated(fault, ranges)


SIX = ["a", "b", "c", "d", "e", "f"]


def fmu(**changes: Any) -> config.FmuPlant:
    return config.FmuPlant.model_validate({**FMU, **changes})


@pytest.mark.parametrize("key", ["force", "length", "rate", "brake", "wrench"])
def test_six_variables_or_one_array_are_mapped_each_once_and_brakes_and_a_wrench_need_not_be(key):
    for names in (["a"], SIX):
        assert getattr(fmu(**{key: names}), key) == names
    for names in ([], ["a", "b"], SIX[:5], [*SIX, "g"]):
        if key in {"brake", "wrench"} and not names:
            assert getattr(fmu(**{key: names}), key) == []
            continue
        empty = ", or an empty list" if key in {"brake", "wrench"} else ""
        with pytest.raises(ValidationError, match=rf"array of six{empty}, given: {len(names)}"):
            fmu(**{key: names})
    with pytest.raises(ValidationError, match=r"the same variable twice: b, f\b"):
        fmu(**{key: ["a", "f", "b", "b", "e", "f"]})


def test_units_are_assumed_of_keys_and_of_variables_that_are_mapped_and_of_nothing_else():
    mapped = {
        "f": "N",
        "q": "m",
        "v": "m/s",
        "w": "N.m",
        "force": "N",
        "length": "m",
        "rate": "m/s",
        "wrench": "N",
    }
    assert fmu(wrench=["w"], assume_unit=mapped).assume_unit == mapped
    for strange in ("w", "b", "brake", "other"):
        with pytest.raises(
            ValidationError, match=rf"not mapped: {strange}; allowed: force, length, rate, wrench,"
        ):
            fmu(brake=["b"], assume_unit={strange: "N", "f": "N"})
    with pytest.raises(ValidationError, match="not mapped: t, u; allowed"):
        fmu(assume_unit={"u": "N", "f": "N", "t": "m"})


def test_a_tool_is_allowed_in_a_process_of_its_own_alone():
    assert fmu(allow_execution_tool=True).allow_execution_tool
    assert not fmu(isolation="in_process").allow_execution_tool
    with pytest.raises(ValidationError, match="allowed with it: isolation child_process"):
        fmu(isolation="in_process", allow_execution_tool=True)
