"""A second encoder on each leg: the leg with a wrong encoder is found, and which of its two is wrong where it shows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.arrays import Rows
from drivers.signals import Doubt, Fault, Mode, Warn
from drivers.tick_columns import SENSORS
from hil.app.configuration.configuration import Configuration
from plant_fmu.faults import kinds
from plant_fmu.faults.fault import Fault as PlantFault
from tests.broad import broad
from tests.loop.bench import changed, run
from tests.loop.fusion_runs import SOON
from tests.loop.test_sensor_families import ENCODERS

BUS: dict[str, Any] = {
    "channels": [{"channel": "hil0", "legs": [0, 1, 2, 3, 4, 5]}, {"channel": "sensors0", "layout": "fd"}],
    "max_load_percent": 90,
}
TRACKER = {"rate_Hz": 200, "channel": "sensors0"}
REST = {"type": "hold", "duration_s": 3.0}
DRIVES, SECOND, EITHER, NOTHING = "drive's", "second", "one of two", "nothing"


class Found(NamedTuple):
    """What a run says about its encoders."""

    which: str
    """DRIVES, SECOND, EITHER or NOTHING."""
    leg: int
    fault_tick: int
    rows: Rows
    faults: Fault


def bench(*, tracker: bool = False, **sections: Any) -> Configuration:
    """`virtual` with a draw-wire encoder on each leg, and perhaps a tracker, on a second bus."""
    sensors: dict[str, Any] = {"lengths": ENCODERS | {"channel": "sensors0"}}
    if tracker:
        sensors["tracker"] = TRACKER
    return changed("virtual", **{"bus": BUS, "sensors": sensors} | SOON | sections)


def found(c: Configuration, *faults: PlantFault) -> Found:
    """Run to the end with faults."""
    rows: list[Any] = []
    ran = run(c, *faults, watch=lambda _lockstep, _inp, row: rows.append(row.copy()))
    ticks = np.array(rows, rows[0].dtype)
    doubted = np.flatnonzero(ticks["legs_doubted"])
    wrong = int(ran.cycle.parts.safety.memory["second_wrong"])
    if len(doubted):
        first = ticks[doubted[0]]
        which = EITHER if first["doubt"] == Doubt.EITHER else DRIVES
        bits, at = int(first["legs_doubted"]), int(first["tick"])
    else:
        which, bits, at = (SECOND, wrong, -1) if wrong else (NOTHING, 1, -1)
    assert bits.bit_count() == 1
    return Found(which, bits.bit_length() - 1, at, ticks, ran.cycle.faults)


def drives(leg: int, at_s: float) -> dict[str, PlantFault]:
    """Faults of a drive's encoder by name."""
    at: dict[str, Any] = {"leg": leg, "at_s": at_s, "mode": "TRACKING"}
    return {
        "jump": kinds.EncoderJump(**at, by_m=2e-3),
        "freeze": kinds.EncoderFreeze(**at),
        "drift": kinds.EncoderDrift(**at, by_m_s=5e-3),
        "scale": kinds.EncoderScale(**at, factor=1.05),
        "sign": kinds.EncoderSign(**at),
        "late": kinds.EncoderLate(**at, by_ms=5.0),
    }


def seconds(leg: int, at_s: float) -> dict[str, PlantFault]:
    """Faults of a second encoder by name."""
    at: dict[str, Any] = {"sensor": f"length_{leg}", "at_s": at_s, "mode": "TRACKING"}
    return {
        "offset": kinds.SensorOffset(**at, by=4e-3),
        "frozen": kinds.SensorFrozen(**at),
        "second drift": kinds.SensorDrift(**at, by=5e-3),
    }


TOLD = {"jump": DRIVES, "freeze": DRIVES, "sign": DRIVES, "late": DRIVES, "offset": SECOND, "frozen": SECOND}
"""Faults whose encoder shows without a tracker, in motion."""
WITH_TRACKER = TOLD | {"drift": DRIVES, "scale": DRIVES, "second drift": SECOND}
CASES = [
    (fault, leg, tracker)
    for fault in (*drives(0, 0.0), *seconds(0, 0.0))
    for leg in range(6)
    for tracker in (False, True)
]


@pytest.mark.parametrize(("fault", "leg", "tracker"), broad(CASES, quick=3))
def test_encoder_fault_in_motion_is_reported_with_its_leg_and_the_wrong_encoder(fault, leg, tracker):
    struck = (drives(leg, 0.6) | seconds(leg, 0.6))[fault]
    of = found(bench(tracker=tracker), struck)
    expected = (WITH_TRACKER if tracker else TOLD).get(fault, EITHER)
    assert of.which == expected or (fault == "scale" and of.which == DRIVES), "a scale may leap"
    assert of.leg == leg
    assert (Fault.ENCODER in of.faults) == (of.which != SECOND)


AT_REST = [
    *(("jump", DRIVES, tracker) for tracker in (False, True)),
    *(("offset", SECOND, tracker) for tracker in (False, True)),
    *(("drift", (EITHER, DRIVES)[tracker], tracker) for tracker in (False, True)),
    *(("second drift", (EITHER, SECOND)[tracker], tracker) for tracker in (False, True)),
    *((fault, NOTHING, False) for fault in ("freeze", "scale", "late", "frozen")),
]


@pytest.mark.parametrize(("fault", "which", "tracker"), broad(AT_REST, quick=1))
def test_encoder_fault_at_rest_is_reported_unless_both_encoders_read_equal(fault, which, tracker):
    struck = (drives(3, 0.6) | seconds(3, 0.6))[fault]
    of = found(bench(tracker=tracker, reference=REST), struck)
    assert of.which == which or (fault == "freeze" and of.which == EITHER), "as the brakes close"
    if of.which != NOTHING:
        assert of.leg == 3


@pytest.mark.parametrize(
    ("struck", "which"),
    [
        (kinds.EncoderDrift(leg=4, mode="LOADING", by_m_s=5e-3), DRIVES),
        (kinds.SensorDrift(sensor="length_4", mode="LOADING", by=5e-3), SECOND),
    ],
)
def test_encoder_whose_reading_alone_changes_on_closed_brakes_is_reported_as_wrong(struck, which):
    of = found(bench(engage={"force_ramp_s": 0.5, "brake_release_s": 0.02, "blend_s": 0.1}), struck)
    assert (of.which, of.leg) == (which, 4)


def test_encoder_drift_of_0_1_mm_per_s_is_detected_by_a_second_encoder_within_5_s():
    slow = bench(reference={"type": "hold", "duration_s": 6.0})
    of = found(slow, kinds.EncoderDrift(leg=1, at_s=0.2, mode="TRACKING", by_m_s=1e-4))
    assert (of.which, of.leg) == (EITHER, 1)
    begin = int(of.rows["tick"][np.argmax(of.rows["mode"] == Mode.TRACKING)]) + 200
    assert of.fault_tick - begin < 5000


def test_contradiction_of_two_encoders_is_only_a_warning_if_so_configured():
    lengths = ENCODERS | {"channel": "sensors0", "on_contradiction": "warn"}
    of = found(bench(sensors={"lengths": lengths}), drives(0, 0.6)["scale"])
    assert (of.faults, of.which) == (Fault.NONE, NOTHING)
    apart = of.rows["sensor_share"][:, SENSORS.index("length_0")] > 1.0
    assert apart.any()
    assert np.all(of.rows["warnings"][apart] & Warn.SENSOR)


def test_silent_second_encoder_causes_a_warning_and_does_not_count_as_contradiction():
    of = found(bench(), kinds.SensorLost(sensor="length_5", at_s=0.6, mode="TRACKING"))
    assert (of.faults, of.which) == (Fault.NONE, NOTHING)
    assert np.isinf(of.rows["sensor_share"][:, SENSORS.index("length_5")]).any()
    assert (of.rows["warnings"] & Warn.SENSOR).any()


NOISY: dict[str, Any] = {"noise_m": 1e-4}
STRAY: dict[str, Any] = {"noise_m": 3e-5, "outlier_percent": 0.5, "outlier_stds": 400}


def noisy(noise: dict[str, Any], rate_Hz: float = 500, **sections: Any) -> Configuration:
    """A bench whose second encoders run free, with noise."""
    lengths = {
        "rate_Hz": rate_Hz,
        "channel": "sensors0",
        "device": ENCODERS["device"] | {"trigger": "cyclic"},
    }
    plant = SOON["plant"] | {"sensors": {"lengths": noise}}
    return bench(**{"sensors": {"lengths": lengths}, "plant": plant} | sections)


@pytest.mark.parametrize("noise", [NOISY, STRAY])
@pytest.mark.parametrize("rate_Hz", [100, 500])
@pytest.mark.parametrize("reference", [REST, SOON["reference"]])
def test_noise_and_single_outliers_of_second_encoders_are_no_contradiction(noise, rate_Hz, reference):
    of = found(noisy(noise, rate_Hz, reference=reference))
    assert (of.which, of.faults) == (NOTHING, Fault.NONE)


@pytest.mark.parametrize("noise", [NOISY, STRAY])
def test_drift_of_a_drive_encoder_is_detected_despite_noise_and_outliers_of_the_second_encoder(noise):
    drift = kinds.EncoderDrift(leg=0, at_s=0.6, mode="TRACKING", by_m_s=5e-3)
    of = found(noisy(noise, reference=REST), drift)
    assert (of.which, of.leg) == (EITHER, 0)


def test_second_encoder_that_agrees_again_after_a_fault_is_used_again_to_detect_drift():
    rest = {"type": "hold", "duration_s": 6.0}
    once = kinds.SensorOffset(sensor="length_0", at_s=0.2, for_s=0.5, mode="TRACKING", by=4e-3)
    drift = kinds.EncoderDrift(leg=0, at_s=3.0, mode="TRACKING", by_m_s=5e-3)
    of = found(bench(reference=rest), once, drift)
    assert (of.which, of.leg) == (EITHER, 0)


@pytest.mark.parametrize("fault", ["jump", "freeze"])
def test_pose_fusion_excludes_a_drive_encoder_that_the_second_encoder_contradicts(fault):
    fused = {"pose": "fused", "fusion": {"may_lose_legs": [2]}}
    of = found(bench(tracker=True, estimation=fused), drives(2, 0.6)[fault])
    assert of.which == NOTHING
    assert Fault.ENCODER not in of.faults
    assert of.rows["legs_slipped"][of.rows["mode"] == Mode.TRACKING][-1] == 1 << 2
