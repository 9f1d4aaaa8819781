"""The fault vocabulary: when faults are present, what they refuse, and that chance is seeded."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.protocol import Frame
from plant_fmu.drives.faults import FAULTS
from plant_fmu.drives.faults.encoder import EncoderFreeze, EncoderOffset
from plant_fmu.drives.faults.fault import Fault, LegFault
from plant_fmu.drives.faults.frames import FrameCorruption, FrameLoss
from plant_fmu.drives.faults.leg import LegGain, Silence, StuckBrake
from plant_fmu.drives.faults.load import WrenchStep
from plant_fmu.drives.faults.plan import FaultPlan

FRAME = Frame(0x282, bytes(range(12)), 6)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: EncoderFreeze(leg=6), "leg"),
        (lambda: EncoderFreeze(leg=-1), "leg"),
        (lambda: Silence(leg=0, start_s=2.0, stop_s=1.0), "start_s < stop_s"),
        (lambda: Silence(leg=0, start_s=1.0, stop_s=1.0), "start_s < stop_s"),
        (lambda: Silence(leg=0, stop_s=nan), "start_s < stop_s"),
        (lambda: Silence(leg=0, start_s=-1.0), "start_s"),
        (lambda: Silence(leg=0, start_s=inf), "start_s"),
        (lambda: Silence(leg=0, start_s=nan), "start_s"),
        (lambda: EncoderOffset(leg=0, offset_m=nan), "offset_m"),
        (lambda: LegGain(leg=0, gain=inf), "gain"),
        (lambda: WrenchStep(wrench=(0.0, 0.0, nan, 0.0, 0.0, 0.0)), "wrench"),
        (lambda: FrameLoss(probability=1.1), "probability"),
        (lambda: FrameCorruption(probability=nan), "probability"),
    ],
)
def test_senseless_faults_are_refused(make: Callable[[], Fault], key: str):
    with pytest.raises(ValidationError, match=rf"(?m)^{key}|error, {key}"):
        make()


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_of_the_table_changes_a_plan_that_was_without_faults(name):
    more: dict[str, Any] = {"encoder_offset": {"offset_m": 1e-3}, "wrench_step": {"wrench": (1.0,) * 6}}
    where = {"leg": 5} if issubclass(FAULTS[name], LegFault) else {}
    plan = FaultPlan([FAULTS[name](**where, **more.get(name, {}))])
    healthy = FaultPlan().present(0.0)
    changed = str(vars(plan.present(0.0))) != str(vars(healthy))
    passed = plan.pass_on(FRAME, 0.0, np.random.default_rng(0)) == FRAME
    assert changed is passed


def test_faults_are_present_from_start_until_just_before_stop():
    plan = FaultPlan([LegGain(leg=2, start_s=0.5, stop_s=1.0), StuckBrake(leg=1, engaged=False, start_s=1.0)])
    assert plan.edges_s() == [0.5, 1.0]
    gains = [plan.present(t).gain[2] for t in (0.0, 0.499_999, 0.5, 0.999_999, 1.0)]
    assert gains == [1.0, 1.0, -1.0, -1.0, 1.0]
    assert [plan.present(t).stuck[1] for t in (0.999, 1.0)] == [None, False]


def test_offsets_and_wrenches_add_up():
    push = WrenchStep(wrench=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    plan = FaultPlan([push, push, EncoderOffset(leg=3, offset_m=1e-3), EncoderOffset(leg=3, offset_m=2e-3)])
    assert plan.present(0.0).wrench.tolist() == [2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    assert plan.present(0.0).offset_m == [0, 0, 0, pytest.approx(3e-3), 0, 0]


def test_without_frame_faults_every_frame_passes():
    plan = FaultPlan([Silence(leg=0)])
    assert not plan.touches_frames
    assert plan.pass_on(FRAME, 0.0, np.random.default_rng(0)) is FRAME


def test_loss_strikes_the_named_identifier_in_its_time_only():
    plan = FaultPlan([FrameLoss(identifier=0x282, start_s=1.0, stop_s=2.0)])
    generator = np.random.default_rng(0)
    assert plan.pass_on(FRAME, 1.5, generator) is None
    assert plan.pass_on(FRAME, 0.5, generator) is FRAME
    assert plan.pass_on(FRAME, 2.0, generator) is FRAME
    other = FRAME._replace(id=0x281)
    assert plan.pass_on(other, 1.5, generator) is other


def test_loss_has_its_probability_and_repeats_with_the_seed():
    plan = FaultPlan([FrameLoss(probability=0.1)], seed=7)

    def lost() -> list[bool]:
        generator = np.random.default_rng(plan.seed)
        return [plan.pass_on(FRAME, 0.0, generator) is None for _ in range(10_000)]

    first = lost()
    assert first == lost()
    assert abs(sum(first) - 1000) < 5 * (10_000 * 0.1 * 0.9) ** 0.5  # five standard deviations


def test_corruption_flips_one_bit_and_leaves_empty_frames():
    plan = FaultPlan([FrameCorruption()])
    generator = np.random.default_rng(1)
    places = set()
    for _ in range(2000):
        frame = plan.pass_on(FRAME, 0.0, generator)
        assert frame is not None
        assert (frame.id, frame.flags) == (FRAME.id, FRAME.flags)
        change = int.from_bytes(frame.data, "big") ^ int.from_bytes(FRAME.data, "big")
        assert change.bit_count() == 1
        places.add(change)
    assert len(places) == 96
    empty = Frame(1, b"")
    assert plan.pass_on(empty, 0.0, generator) is empty
