"""The fault vocabulary: what each kind refuses, when faults are present, and that chance is seeded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, nan
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BUS, Frame
from plant_fmu.faults import FAULTS
from plant_fmu.faults.fault import NEVER_NS, Fault
from plant_fmu.faults.kinds import (
    BrakeSlipping,
    BrakeSlow,
    BrakeStuckClosed,
    BrakeStuckOpen,
    BusFlood,
    BusOff,
    BusSecondController,
    DriveGain,
    DriveReset,
    DriveSaturation,
    DriveSign,
    DriveSilence,
    EncoderDrift,
    EncoderFreeze,
    EncoderJump,
    EncoderLate,
    EncoderNoise,
    EncoderScale,
    EncoderSign,
    FramesCorrupt,
    FramesDelay,
    FramesDuplicate,
    FramesForgedCommand,
    FramesForgedFeedback,
    FramesLoss,
    FramesOld,
    FramesReorder,
    PayloadStep,
    ProcessStop,
    WrenchStep,
)
from plant_fmu.faults.plan import FaultPlan, Schedule, weight
from plant_fmu.plant import Truth

MS = 1_000_000
S = 1_000_000_000
FRAME = Frame(0x282, bytes(range(12)), 6)
SIZES: dict[str, dict[str, Any]] = {
    "encoder_jump": {"by_m": 1e-3},
    "encoder_drift": {"by_m_s": 1e-3},
    "encoder_noise": {"sigma_m": 1e-3},
    "encoder_scale": {"factor": 1.01},
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
    leg = {"leg": 5} if "leg" in kind.model_fields else {}
    return kind(**{"kind": name, **leg, **SIZES.get(name, {}), **more})


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: EncoderFreeze(leg=6), "leg"),
        (lambda: EncoderFreeze(leg=-1), "leg"),
        (lambda: DriveSilence(leg=0, at_s=2.0, for_s=-1), "for_s"),
        (lambda: DriveSilence(leg=0, for_s=0), "for_s"),
        (lambda: DriveSilence(leg=0, for_s=inf), "for_s"),
        (lambda: DriveSilence(leg=0, for_s=nan), "for_s"),
        (lambda: DriveSilence(leg=0, at_s=-1.0), "at_s"),
        (lambda: DriveSilence(leg=0, at_s=inf), "at_s"),
        (lambda: DriveSilence(leg=0, at_s=nan), "at_s"),
        (lambda: DriveSilence(leg=0, mode="FAULT"), "mode"),  # type: ignore[arg-type]
        (lambda: DriveReset(leg=0, for_s=1.0), "for_s"),  # type: ignore[call-arg]
        (lambda: EncoderJump(leg=0, by_m=nan), "by_m"),
        (lambda: EncoderLate(leg=0, by_ms=0.0), "by_ms"),
        (lambda: DriveGain(leg=0, factor=inf), "factor"),
        (lambda: BrakeSlipping(leg=0, share=1.1), "share"),
        (lambda: WrenchStep(force_N=(0.0, 0.0, nan)), "force_N"),
        (lambda: PayloadStep(mass_kg=0.0), "mass_kg"),
        (lambda: FramesLoss(probability=1.1), "probability"),
        (lambda: FramesCorrupt(probability=nan), "probability"),
        (lambda: FramesOld(back=0), "back"),
        (lambda: BusFlood(rate_Hz=0.0), "rate_Hz"),
        (lambda: BusFlood(identifier=0x800), "identifier"),
        (ProcessStop, "for_s"),
    ],
)
def test_senseless_faults_are_refused(make: Callable[[], Fault], key: str):
    with pytest.raises(ValidationError, match=rf"(?m)^{key}"):
        make()


def test_a_kind_is_called_what_its_row_says():
    for name, kind in FAULTS.items():
        assert kind.model_fields["kind"].default == name
        assert get_args(kind.model_fields["kind"].annotation) == (name,)


@pytest.mark.parametrize("name", [name for name in FAULTS if not name.startswith("process")])
def test_every_fault_of_the_table_changes_a_run_that_was_without_faults(name):
    def outcome(*faults: Fault) -> str:
        plan = FaultPlan(faults)
        schedule = Schedule(plan, 0)
        present = vars(schedule.present(0))
        here = {key: value for key, value in present.items() if key not in ("since_ns", "generator")}
        carried = [schedule.carry(k * MS, FRAME._replace(data=bytes([k])), to_drives=True) for k in range(3)]
        return str((here, carried, [fault for fault, _ in schedule.senders()], plan.touches_frames))

    assert outcome() == outcome()
    assert outcome(example(name)) != outcome()


def test_faults_are_present_from_their_start_and_just_not_at_their_end():
    faults = [DriveGain(leg=2, factor=-1.0, at_s=0.5, for_s=0.5), BrakeStuckOpen(leg=1, at_s=1.0)]
    schedule = Schedule(FaultPlan(faults), 7 * S)
    assert [schedule.starts_ns(fault) for fault in faults] == [7.5 * S, 8 * S]
    assert schedule.edges_ns(7 * S) == [7.5 * S, 8 * S]
    assert schedule.edges_ns(round(7.6 * S)) == [8 * S]
    times = [7 * S, round(7.5 * S) - 1, round(7.5 * S), 8 * S - 1, 8 * S]
    assert [schedule.present(t).gain[2] for t in times] == [1.0, 1.0, -1.0, -1.0, 1.0]
    assert [schedule.present(t).stuck[1] for t in times[-2:]] == [None, False]


def test_a_fault_of_a_mode_waits_for_it_and_counts_from_there():
    fault = EncoderFreeze(leg=0, mode="APPROACH", at_s=0.2, for_s=0.1)
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


def test_jumps_drifts_gains_shares_and_wrenches_of_several_faults_are_joined():
    faults = [
        *[WrenchStep(force_N=(1.0, 2.0, 3.0), moment_N_m=(4.0, 5.0, 6.0))] * 2,
        EncoderJump(leg=3, by_m=1e-3),
        EncoderJump(leg=3, by_m=2e-3),
        EncoderDrift(leg=4, by_m_s=1e-3, at_s=1.0),
        *[BrakeSlipping(leg=2, share=0.5)] * 2,
        *[DriveGain(leg=1, factor=3.0)] * 2,
    ]
    present = Schedule(FaultPlan(faults), 0).present(2 * S)
    assert present.wrench.tolist() == [2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    assert present.offset_m == [0, 0, 0, pytest.approx(3e-3), 0, 0]
    assert present.drifts == [(4, 1e-3, S)]
    assert present.share == [1, 1, 0.25, 1, 1, 1]
    assert present.gain == [1, 9.0, 1, 1, 1, 1]


def test_of_several_faults_delays_add_up_signs_multiply_and_the_smallest_limit_or_the_last_word_counts():
    faults = [
        *[EncoderLate(leg=5, by_ms=1.5)] * 2,
        *[EncoderScale(leg=4, factor=3.0)] * 2,
        EncoderSign(leg=4),
        *[DriveSign(leg=3)] * 3,
        *[DriveSaturation(leg=3, limit_N=limit) for limit in (200.0, 100.0, 300.0)],
        *[BrakeSlow(leg=2, by_ms=20.0)] * 2,
        BrakeStuckOpen(leg=1),
        BrakeStuckClosed(leg=1),
        BrakeStuckClosed(leg=2),
        BrakeStuckOpen(leg=2),
        *[FramesForgedFeedback(leg=1, by_m=by_m) for by_m in (1e-3, 2e-3)],
        *[EncoderDrift(leg=leg, by_m_s=1e-3) for leg in (1, 1, 2)],
        *[EncoderNoise(leg=leg, sigma_m=1e-3) for leg in (1, 1, 2)],
        *[PayloadStep(mass_kg=mass) for mass in (10.0, 20.0)],
    ]
    present = Schedule(FaultPlan(faults), 0).present(0)
    assert present.late_ns == [0, 0, 0, 0, 0, 3 * MS]
    assert present.scales == [(4, 3.0, 0), (4, 3.0, 0), (4, -1.0, 0)]
    assert present.gain == [1, 1, 1, -1.0, 1, 1]
    assert present.saturation_N == [inf, inf, inf, 100.0, inf, inf]
    assert present.slow_ns == [0, 0, 40 * MS, 0, 0, 0]
    assert present.stuck == [None, True, False, None, None, None]
    assert present.forged_m == [None, 2e-3, None, None, None, None]
    assert [leg for leg, *_ in present.drifts] == [1, 1, 2]
    assert [leg for leg, *_ in present.noise] == [1, 1, 2]
    assert [mass for mass, _ in present.masses] == [10.0, 20.0]


def test_a_payload_weighs_at_its_place_on_the_turned_platform():
    """10 kg, 0.5 m along the platform's x axis, which points along the base's y axis."""
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    truth = Truth(np.zeros(3), R, np.zeros(6), np.zeros(6))
    present = Schedule(FaultPlan([PayloadStep(mass_kg=10.0, position_m=(0.5, 0.0, 0.0))]), 0).present(0)
    wrench = weight(present.masses, truth, np.array([0.0, 0.0, -10.0]))
    np.testing.assert_allclose(wrench, [0, 0, -100.0, -50.0, 0, 0], atol=1e-12)


# frames


def carry(schedule: Schedule, t_ns: int, frame: Frame = FRAME, *, to_drives: bool = True) -> list[Any]:
    return schedule.carry(t_ns, frame, to_drives=to_drives)


def test_without_frame_faults_every_frame_passes():
    plan = FaultPlan([DriveSilence(leg=0)])
    assert not plan.touches_frames
    assert carry(Schedule(plan, 0), 5) == [(5, FRAME, False)]


def test_loss_strikes_the_named_identifier_in_its_time_only():
    schedule = Schedule(FaultPlan([FramesLoss(identifier=0x282, at_s=1.0, for_s=1.0)]), 0)
    assert carry(schedule, round(1.5 * S)) == []
    for t_ns, frame in ((S // 2, FRAME), (2 * S, FRAME), (round(1.5 * S), FRAME._replace(id=0x281))):
        assert carry(schedule, t_ns, frame) == [(t_ns, frame, False)]


def test_bus_off_takes_every_frame_of_both_directions():
    schedule = Schedule(FaultPlan([BusOff(at_s=1.0, for_s=1.0)]), 0)
    for to_drives in (True, False):
        assert carry(schedule, S, to_drives=to_drives) == []
        assert carry(schedule, 2 * S, to_drives=to_drives) == [(2 * S, FRAME, False)]
    assert schedule.present(S).bus_off


@pytest.mark.parametrize("kind", [FramesLoss, FramesDuplicate])
def test_chance_has_its_probability_and_repeats_with_the_seed(kind):
    def struck(seed: int, of_plan: int = 7) -> list[bool]:
        schedule = Schedule(FaultPlan([kind(probability=0.1, seed=seed)], seed=of_plan), 0)
        return [len(carry(schedule, 0)) != 1 for _ in range(10_000)]

    first = struck(3)
    assert first == struck(3)
    assert first != struck(4)
    assert first != struck(3, of_plan=8)
    assert abs(sum(first) - 1000) < 5 * (10_000 * 0.1 * 0.9) ** 0.5  # five standard deviations


def test_two_faults_of_one_seed_strike_independently():
    schedule = Schedule(FaultPlan([FramesLoss(probability=0.5), FramesLoss(probability=0.5)]), 0)
    passed = sum(len(carry(schedule, 0)) for _ in range(10_000))
    assert abs(passed - 2500) < 5 * (10_000 * 0.25 * 0.75) ** 0.5


def test_corruption_flips_one_bit_and_leaves_empty_frames():
    schedule = Schedule(FaultPlan([FramesCorrupt()]), 0)
    places = set()
    for _ in range(2000):
        ((_, frame, foreign),) = carry(schedule, 0)
        assert not foreign
        assert (frame.id, frame.flags) == (FRAME.id, FRAME.flags)
        change = int.from_bytes(frame.data, "big") ^ int.from_bytes(FRAME.data, "big")
        assert change.bit_count() == 1
        places.add(change)
    assert len(places) == 96
    empty = Frame(1, b"")
    assert carry(schedule, 0, empty) == [(0, empty, False)]


def numbered(schedule: Schedule, identifiers: str = "aaaa") -> list[tuple[str, int, bool]]:
    """Pass frames one a ms on; return identifier, number and foreign of what arrives, in order."""
    found = []
    for k, name in enumerate(identifiers):
        frame = Frame(ord(name), bytes([k]))
        found += [(chr(f.id), f.data[0], foreign) for _, f, foreign in carry(schedule, k * MS, frame)]
    return found


def on_buses(schedule: Schedule, buses: Sequence[int], *, to_drives: bool) -> list[tuple[int, int]]:
    """Pass frames of one identifier, one a ms, each on its bus; return bus and number of what arrives."""
    found = []
    for k, bus in enumerate(buses):
        arriving = carry(schedule, k * MS, Frame(0x80, bytes([k]), BUS * bus), to_drives=to_drives)
        found += [(frame.bus, frame.data[0]) for _, frame, _ in arriving]
    return found


def test_a_delayed_frame_is_late_by_so_much():
    schedule = Schedule(FaultPlan([FramesDelay(by_ms=1.5)]), 0)
    assert carry(schedule, 10 * MS) == [(11_500_000, FRAME, False)]


def test_frames_out_of_order_change_places_with_the_next_of_their_identifier():
    schedule = Schedule(FaultPlan([FramesReorder()]), 0)
    assert numbered(schedule, "abab") == [("a", 2, False), ("a", 0, False), ("b", 3, False), ("b", 1, False)]


def test_frames_of_both_directions_do_not_change_places():
    schedule = Schedule(FaultPlan([FramesReorder()]), 0)
    assert carry(schedule, 0, to_drives=True) == []
    assert carry(schedule, 1, to_drives=False) == []
    assert len(carry(schedule, 2, to_drives=True)) == 2


@pytest.mark.parametrize("to_drives", [True, False])
def test_frames_of_one_identifier_on_several_buses_change_places_each_on_its_own(to_drives: bool):
    schedule = Schedule(FaultPlan([FramesReorder()]), 0)
    found = on_buses(schedule, (0, 1, 1, 0), to_drives=to_drives)
    assert found == [(1, 2), (1, 1), (0, 3), (0, 0)]


@pytest.mark.parametrize("to_drives", [True, False])
def test_an_old_frame_comes_from_its_own_bus(to_drives: bool):
    schedule = Schedule(FaultPlan([FramesOld(back=1)]), 0)
    found = on_buses(schedule, (0, 1, 0, 1), to_drives=to_drives)
    assert found == [(0, 0), (1, 1), (0, 2), (0, 0), (1, 3), (1, 1)]


def test_an_old_frame_follows_the_present_one_and_is_a_strangers():
    schedule = Schedule(FaultPlan([FramesOld(back=2)]), 0)
    new = [("a", k, False) for k in range(4)]
    assert numbered(schedule) == [new[0], new[1], new[2], ("a", 0, True), new[3], ("a", 1, True)]


def test_a_flood_wins_against_every_identifier_of_the_protocol():
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
    (there,) = BusFlood(identifier=0x123, bus=2).frames(protocol, 7)
    assert (there.id, there.data, there.bus) == (0x123, bytes(8), 2)
    (frame,) = BusFlood().frames(protocol, 0)
    assert frame.id < min(f.id for f in (*protocol.traits.cyclic_frames, *protocol.traits.emergency_stop))
    assert not frame.flags


@pytest.mark.parametrize("bus", [0, 1])
def test_a_second_controller_sends_on_its_own_bus_alone(bus):
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6), 60_000.0, ((0, 1, 2), (3, 4, 5)))
    frames = BusSecondController(bus=bus).frames(protocol, 0)
    assert [frame.bus for frame in frames] == [bus] * 2


def test_frames_are_touched_where_any_one_of_the_faults_does_so():
    others = [DriveSilence(leg=0), WrenchStep()]
    for fault in (FramesLoss(), BusOff(), BusFlood(), BusSecondController(), FramesForgedCommand()):
        for faults in ([fault], [fault, *others], [*others, fault]):
            assert FaultPlan(faults).touches_frames
    assert not FaultPlan(others).touches_frames
    assert not FaultPlan().touches_frames


@pytest.mark.parametrize("first", [DriveSilence(leg=0, at_s=9.0), DriveSilence(leg=0, mode="PARKED")])
def test_each_sender_has_its_own_time_and_none_sends_before_its_mode_is_reached(first):
    bounded, waiting = BusFlood(at_s=1.0, for_s=2.0), BusFlood(mode="TRACKING", at_s=0.5, for_s=4.0)
    schedule = Schedule(FaultPlan([first, bounded, waiting, BusSecondController(at_s=3.0)]), 7 * S)

    def sending() -> list[tuple[Fault, int, int]]:
        return [(fault, own.start_ns, own.stop_ns) for fault, own in schedule.senders()]

    second = (BusSecondController(at_s=3.0), 10 * S, 10 * S + NEVER_NS)
    assert sending() == [(bounded, 8 * S, 10 * S), second]
    schedule.reached("TRACKING", 20 * S)
    begun = (waiting, round(20.5 * S), round(24.5 * S))
    assert sending() == [(bounded, 8 * S, 10 * S), begun, second]


def test_a_bus_that_is_off_is_the_one_that_is_named_or_else_every_one():
    """As many as legs."""
    for bus in range(6):
        assert Schedule(FaultPlan([BusOff(bus=bus)]), 0).present(0).bus_off == 1 << bus
    assert Schedule(FaultPlan([BusOff()]), 0).present(0).bus_off == 0b111111
    assert Schedule(FaultPlan([BusOff(bus=0), BusOff(bus=4)]), 0).present(0).bus_off == 0b010001


def test_a_fault_without_a_seed_has_the_seed_0():
    losses = FramesLoss(probability=0.5), FramesLoss(probability=0.5, seed=0)
    schedules = [Schedule(FaultPlan([each]), 0) for each in losses]
    passed = [[len(carry(schedule, 0)) for _ in range(100)] for schedule in schedules]
    assert passed[0] == passed[1]
    noises = EncoderNoise(leg=0, sigma_m=1.0), EncoderNoise(leg=0, sigma_m=1.0, seed=0)
    drawn = [Schedule(FaultPlan([each]), 0).present(0).noise[0][2].random() for each in noises]
    assert drawn[0] == drawn[1]
