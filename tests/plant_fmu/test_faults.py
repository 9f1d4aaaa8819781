"""Settings of faults: invalid ones are refused, faults are present at their times, several faults combine."""

from __future__ import annotations

import itertools
from functools import partial
from math import inf, nan
from typing import Any, get_args

import pytest
from pydantic import TypeAdapter, ValidationError

from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame
from plant_fmu.config import DriveEmulation, StewartPlant
from plant_fmu.faults import FAULTS, AnyFault, kinds
from plant_fmu.faults.fault import NEVER_NS, Fault
from plant_fmu.faults.plan import FaultPlan, Schedule

MS, S = 1_000_000, 1_000_000_000
FRAME = Frame(0x282, bytes(range(12)), 6)
PROTOCOL = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
SIZES: dict[str, dict[str, Any]] = {
    "encoder_jump": {"by_m": 1e-3},
    "encoder_drift": {"by_m_s": 1e-3},
    "encoder_noise": {"sigma_m": 1e-3},
    "encoder_scale": {"factor": 1.01},
    "sensor_late": {"by_ms": 2.0},
    "sensor_offset": {"by": 1e-3},
    "sensor_drift": {"by": 1e-3},
    "sensor_outlier": {"by": 1e-3},
    "drive_gain": {"factor": 0.5},
    "drive_saturation": {"limit_N": 100.0},
    "brake_slow": {"by_ms": 50.0},
    "brake_slipping": {"share": 0.1},
    "frames_delay": {"by_ms": 2.0},
    "frames_old": {"back": 1},
    "frames_forged_feedback": {"by_m": 1e-3},
    "process_stop": {"for_s": 0.1},
    "process_slow": {"by_ms": 1.0},
    "wrench_step": {"force_N": (1.0, 0.0, 0.0)},
    "payload_step": {"mass_kg": 10.0},
}


def example(name: str, **more: Any) -> Fault:
    kind = FAULTS[name]
    leg = {key: of for key, of in (("leg", 5), ("sensor", "length_5")) if key in kind.model_fields}
    return kind(**{"kind": name, **leg, **SIZES.get(name, {}), **more})


INVALID: dict[str, list[tuple[str, Any]]] = {
    "encoder_freeze": [("leg", 6), ("leg", -1)],
    "drive_silence": [("for_s", 0), ("for_s", inf), ("at_s", -1.0), ("at_s", inf)],
    "drive_reset": [("for_s", 1.0), ("at_s", nan), ("mode", "FAULT")],
    "sensor_lost": [("sensor", "length_6"), ("sensor", "lengths"), ("axis", 6)],
    "sensor_outlier": [("percent", 0.0), ("percent", 101.0), ("by", nan)],
    "brake_slipping": [("share", 1.1)],
    "wrench_step": [("force_N", (0.0, 0.0, nan))],
    "frames_loss": [("probability", 1.1), ("probability", nan)],
    "bus_flood": [("rate_Hz", 0.0), ("identifier", 0x800)],
    "process_stop": [("for_s", None)],
}


@pytest.mark.parametrize(
    ("name", "key", "value"), [(name, *row) for name, rows in INVALID.items() for row in rows]
)
def test_invalid_setting_of_each_kind_of_fault_is_refused_with_its_key(name, key, value):
    example(name)
    with pytest.raises(ValidationError, match=rf"(?m)^{key}"):
        example(name, **{key: value})


def test_class_of_each_fault_is_selected_by_the_key_kind():
    read = TypeAdapter(AnyFault)
    for name, kind in FAULTS.items():
        assert get_args(kind.model_fields["kind"].annotation) == (name,)
        assert type(read.validate_python(example(name).model_dump())) is kind


@pytest.mark.parametrize("name", [name for name in FAULTS if not name.startswith("process")])
def test_every_kind_of_injected_fault_has_an_effect(name):
    def outcome(*faults: Fault) -> str:
        plan = FaultPlan(faults)
        schedule = Schedule(plan, 0)
        present = vars(schedule.present(0))
        here = {key: value for key, value in present.items() if key != "own"}
        carried = [schedule.carry(k * MS, FRAME._replace(data=bytes([k])), to_drives=True) for k in range(3)]
        return str((here, carried, [fault for fault, _ in schedule.senders()], plan.touches_frames))

    assert outcome() == outcome()
    assert outcome(example(name)) != outcome()


def test_fault_tied_to_a_mode_counts_its_time_from_the_first_entry_into_that_mode():
    fault = kinds.EncoderFreeze(leg=0, mode="APPROACH", at_s=0.2, for_s=0.1)
    schedule = Schedule(FaultPlan([fault]), 0)
    assert schedule.starts_ns(fault) == NEVER_NS
    assert schedule.waiting == (fault,)
    assert schedule.edges_ns(0) == []
    assert not schedule.present(10 * S).frozen[0]
    assert not schedule.reached("TRACKING", 3 * S)
    assert schedule.reached("APPROACH", 5 * S)
    assert not schedule.waiting
    assert schedule.edges_ns(5 * S) == [round(5.2 * S), round(5.3 * S)]
    assert schedule.present(round(5.25 * S)).frozen[0]
    assert not schedule.reached("APPROACH", 9 * S), "the first time counts"
    assert not schedule.present(round(9.25 * S)).frozen[0]


SCHEDULED = (
    kinds.DriveSilence(leg=1, at_s=2e-3, for_s=3e-3),
    kinds.DriveReset(leg=2, at_s=3e-3),
    kinds.EncoderJump(leg=3, by_m=1e-3, at_s=4e-3),
    kinds.DriveSilence(leg=4, mode="TRACKING"),
)
T0 = 7 * S
BEGIN_END = (
    (T0 + 2 * MS, T0 + 5 * MS),
    (T0 + 3 * MS, T0 + 3 * MS + 1),
    (T0 + 4 * MS, NEVER_NS),
    (NEVER_NS, NEVER_NS),
)
TIMES = sorted(
    {max(0, edge + by) for ends in BEGIN_END for edge in ends[:2] for by in (-1, 0, 1) if edge < NEVER_NS}
)


def test_active_faults_at_an_instant_do_not_depend_on_earlier_queries():
    schedule = Schedule(FaultPlan(SCHEDULED), T0)
    for t_ns in itertools.chain(*itertools.product(TIMES, TIMES)):
        present = [SCHEDULED.index(own.fault) for own in schedule.active(t_ns)]
        assert present == [n for n, (begin, end) in enumerate(BEGIN_END) if begin <= t_ns < end], t_ns
    assert schedule.edges_ns(T0 + 2 * MS) == [T0 + by for by in (2 * MS, 3 * MS, 3 * MS + 1, 4 * MS, 5 * MS)]
    assert schedule.edges_ns(T0 + 5 * MS + 1) == []
    for at_ns, count in ((2 * MS - 1, 0), (2 * MS, 1), (4 * MS, 3)):
        assert schedule.begun(T0 + at_ns) == SCHEDULED[:count]
    assert schedule.waiting == SCHEDULED[3:]


def test_several_faults_of_one_kind_on_one_leg_add_up_multiply_or_take_the_worst_by_kind():
    faults = [
        *[kinds.WrenchStep(force_N=(1.0, 2.0, 3.0), moment_N_m=(4.0, 5.0, 6.0))] * 2,
        *[kinds.EncoderJump(leg=3, by_m=by_m) for by_m in (1e-3, 2e-3)],
        *[kinds.EncoderLate(leg=5, by_ms=1.5)] * 2,
        *[kinds.BrakeSlipping(leg=2, share=0.5)] * 2,
        *[kinds.BrakeSlow(leg=2, by_ms=20.0)] * 2,
        *[kinds.DriveGain(leg=1, factor=3.0)] * 2,
        *[kinds.DriveSign(leg=3)] * 3,
        *[kinds.DriveSaturation(leg=3, limit_N=limit) for limit in (200.0, 100.0, 300.0)],
        *(
            kinds.BrakeStuckOpen(leg=1),
            kinds.BrakeStuckClosed(leg=1),
            kinds.BrakeStuckClosed(leg=2),
            kinds.BrakeStuckOpen(leg=2),
        ),
        *[kinds.FramesForgedFeedback(leg=1, by_m=by_m) for by_m in (1e-3, 2e-3)],
        *[kinds.EncoderNoise(leg=leg, sigma_m=1e-3) for leg in (1, 1, 2)],
        *[kinds.PayloadStep(mass_kg=mass) for mass in (10.0, 20.0)],
    ]
    present = Schedule(FaultPlan(faults), 0).present(2 * S)
    assert present.wrench.tolist() == [2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    assert present.offset_m == [0, 0, 0, pytest.approx(3e-3), 0, 0]
    assert present.late_ns == [0, 0, 0, 0, 0, 3 * MS]
    assert present.share == [1, 1, 0.25, 1, 1, 1]
    assert present.slow_ns == [0, 0, 40 * MS, 0, 0, 0]
    assert present.gain == [1, 9.0, 1, -1.0, 1, 1]
    assert present.saturation_N == [inf, inf, inf, 100.0, inf, inf]
    assert present.stuck == [None, True, False, None, None, None]
    assert present.forged_m == [None, 2e-3, None, None, None, None]
    assert [leg for leg, *_ in present.noise] == [1, 1, 2]
    assert [mass for mass, _ in present.masses] == [10.0, 20.0]


@pytest.mark.parametrize("section", [DriveEmulation, partial(StewartPlant, type="stewart")])
def test_force_bandwidth_of_a_drive_must_be_0_or_at_least_0_1_hz(section):
    for bandwidth_Hz in (0.0, 0.1, 1e6):
        section(force_bandwidth_Hz=bandwidth_Hz)
    for bandwidth_Hz in (0.0999, 1e-60, -1.0):
        with pytest.raises(ValidationError):
            section(force_bandwidth_Hz=bandwidth_Hz)
