"""Report of a fault: leg, value and limit of its tick, advice, and a section of the glossary."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.sensing.settings import TrackerSettings
from drivers.signals import Doubt, DriveFault, DriveState, Fault, Foreign, Mode, Stop, Warn
from hil.contracts.records import altered
from hil.loop.story.faults import FAULTS
from hil.loop.story.narrator import Narrator
from hil.loop.story.story import DONE, GLOSSARY, Finding, Story
from hil.safety.certificate import CONFIRM, COUNT, POSE, SCALARS
from tests.hil.cycle_bench import VIRTUAL, Bench

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / GLOSSARY).read_text()
SECTIONS = dict(re.findall(r"^### (\S+ \S+)\n(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL))
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:nan|inf|\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?![\w.])")


def test_every_fault_mode_warning_and_stop_has_a_report_text_and_a_docs_section():
    assert sorted(row.fault for row in FAULTS) == sorted(Fault)
    assert all(len(row.advice) > 10 for row in FAULTS)
    assert set(DONE) == set(Mode)
    named: list[Any] = [*Fault, *Warn, *(stop for stop in Stop if stop)]
    kinds: dict[Any, str] = {Fault: "Fault", Warn: "Warning", Stop: "Stop"}
    assert set(SECTIONS) == {f"{kinds[type(each)]} {each.name}" for each in named}
    for name, text in SECTIONS.items():
        if name.startswith("Fault"):
            assert "\nRule\n: " in text, name
            assert "\nWhat to do\n: " in text, name


# -- the numbers of the tick


class Case(NamedTuple):
    """A fault, the columns of its tick, and the expected report."""

    fault: Fault
    columns: dict[str, Any]
    told: list[tuple[int | None, Any, Any]]
    """Leg, value, limit in SI units."""
    words: tuple[str, ...] = ()
    memory: dict[str, Any] = {}


def legs(usual: float, **others: float) -> list[float]:
    """Six equal values with exceptions such as leg_3=1.5."""
    return [others.get(f"leg_{leg}", usual) for leg in range(6)]


def doubted(doubt: Doubt, **columns: Any) -> dict[str, Any]:
    """Columns of a tick in which leg 3 is doubted: 30 um with a limit of 20 um."""
    shown = {"legs_doubted": 8, "doubt": int(doubt), "doubt_value": 3e-5, "doubt_limit": 2e-5}
    return {**shown, **columns}


RUN, OFF, FAILED = int(DriveState.RUN), int(DriveState.OFF), int(DriveState.FAULT)
DOUBTED: list[tuple[int | None, Any, Any]] = [(3, 3e-5, 2e-5)]
STALL, LISTED = ("stalled for 6 ms", "loop.rate_Hz"), ("drive 0, 1 in OFF", "drive 3, 5 in OFF")
CASES = [
    Case(Fault.STALE, {"counted_age": legs(0, leg_1=7, leg_4=5)}, [(1, 7, 5), (4, 5, 5)]),
    Case(Fault.STALE, {"counted_age": legs(6)}, [(None, 6, 5)], STALL),
    Case(Fault.STALE, {"counted_age": legs(0, leg_4=5), "legs_slipped": 2}, [(4, 5, 5)]),
    Case(Fault.STALE, {"legs_slipped": 2}, [(1, None, None)], ("slipped",), {"untrusted": 1}),
    Case(Fault.STALE, {"age": legs(0, leg_1=7), "blind": legs(0, leg_1=1)}, [(1, 7, 5)], ("invalid",), {"untrusted": 1}),
    Case(Fault.STALE, {"counted_age": legs(5)}, [(None, 5, 5)], ("refused",), {"untrusted": 0b1110_10101}),
    Case(
        Fault.DRIVE, {"drive_state": legs(RUN, leg_3=FAILED), "drive_fault": legs(0, leg_3=DriveFault.OVERFORCE)},
        [(3, "FAULT", "RUN")], ("OVERFORCE",),
    ),
    Case(
        Fault.DRIVE, {"drive_state": [OFF, OFF, FAILED, OFF, RUN, OFF]},
        [(leg, "FAULT" if leg == 2 else "OFF", "RUN") for leg in (0, 1, 2, 3, 5)], LISTED, {"running": 1},
    ),
    Case(Fault.BUS, {"bus_off": 1}, [(None, "off", None)]),
    Case(Fault.BUS, {}, [(None, 5, 5)], ("in a row",), {"refused": 0b1011111}),
    Case(Fault.BUS, {}, [(None, 8, 8)], ("of the last 32",), {"refused": 0b1111011110}),
    Case(
        Fault.STROKE, {"q": legs(1.4, leg_2=2.2007, leg_5=0.7481), "dq": 0.0},
        [(2, 2.2007, 2.2), (5, 0.7481, 0.75)], ("platform.length_max_m", "platform.length_min_m"),
    ),
    # soft ends 0.02 m inside; 0.0125 m before one, sqrt(2 * 10 * 0.0125) = 0.5 m/s can be stopped
    Case(
        Fault.STROKE, {"q": legs(1.4, leg_1=2.1675, leg_4=0.7825), "dq": legs(0.0, leg_1=0.6, leg_4=-0.7)},
        [(1, 0.6, 0.5), (4, 0.7, 0.5)], ("limits.deceleration_m_s2",),
    ),
    Case(Fault.SPEED, {"dq": legs(0.1, leg_0=-2.13, leg_3=2.01)}, [(0, 2.13, 2.0), (3, 2.01, 2.0)]),
    # 10 mm, and 10 mm per m/s: at 0.3 m/s 13 mm
    Case(
        Fault.FOLLOWING,
        {"q": 1.4, "q_d": legs(1.4, leg_2=1.4131, leg_4=1.4125), "dq_d": legs(0.0, leg_2=0.3, leg_4=-0.3)},
        [(2, 0.0131, 0.013)], ("limits.following_error_m",),
    ),
    Case(Fault.FOLLOWING, {"q": 1.4, "q_d": 1.4, "dq": legs(0.0, leg_1=-0.031)}, [(1, 0.031, 0.02)], ("moves",)),
    Case(Fault.KINEMATICS, {"fk_residual": 3.5e-4}, [(None, 3.5e-4, 1e-4)], ("limits.consistency_m",)),
    Case(Fault.KINEMATICS, {"fk_residual": inf}, [(None, inf, None)], ("no pose near the last one",)),
    Case(Fault.ASSEMBLY, {"hop": 1.25}, [(None, 1.25, 1.0)]),
    Case(Fault.CONDITION, {"condition": 61.5}, [(None, 61.5, 50.0)]),
    Case(
        Fault.NOT_FINITE, {"length": legs(1.4, leg_3=nan), "twist": legs(0.0, leg_5=inf)},
        [(3, nan, "a finite number"), (None, inf, "a finite number")], ("length of leg 3", "twist"),
    ),
    Case(Fault.LAW, {"tau_asked": legs(100.0, leg_2=-inf)}, [(2, -inf, "a finite force")]),
    Case(Fault.ESTOP, {"foreign": 0}, [(None, "requested at this controller", None)]),
    Case(Fault.ESTOP, {"foreign": int(Foreign.ESTOP)}, [(None, "sent by another node on the bus", None)]),
    Case(
        Fault.SECOND_CONTROLLER, {"foreign": int(Foreign.SYNC | Foreign.CONFIG | Foreign.ESTOP)},
        [(None, "SYNC, CONFIG", None)],
    ),
    Case(Fault.DUPLICATE_NODE, {"doubled": 0b100010}, [(1, None, None), (5, None, None)]),
    Case(Fault.REFUSED_FRAMES, {}, [(None, 9, 8)], ("of the last 32",), {"untrusted": 0b111111111}),
    Case(
        Fault.BRAKE, {"legs_moved": 0b010110, "length": legs(1.4, leg_1=1.4006, leg_2=1.4007, leg_4=1.4006)},
        [(1, 6e-4, 5e-4), (2, 7e-4, 5e-4), (4, 6e-4, 5e-4)],
        ("leg 1, 2, 4 moved 0.60, 0.70, 0.60 mm", "limits.standstill_m"), {"still": np.full(6, 1.4)},
    ),
    Case(Fault.ENCODER, doubted(Doubt.JUMP), DOUBTED, ("jumped",)),
    Case(Fault.ENCODER, doubted(Doubt.LEAP, doubt_value=0.03, doubt_limit=0.02), [(3, 0.03, 0.02)], ("its brake closed",)),
    Case(Fault.ENCODER, doubted(Doubt.STILL), DOUBTED, ("its brake did not open",)),
]  # fmt: skip


def strike(bench: Bench, case: Case) -> tuple[Narrator, list[str]]:
    """Cause a fault in the next tick with these columns; the result is the narrator and the events."""
    events: list[str] = []
    narrator = Narrator(bench.cycle, lambda _t_ns, level, text: events.append(f"{level} {text}"))
    narrator.look()
    tick = bench.cycle.last = bench.cycle.tick
    bench.cycle.tick = altered(tick, **{"tick": int(tick["tick"]) + 1} | case.columns)
    for name, value in case.memory.items():
        bench.cycle.parts.safety.memory[name] = value
    bench.cycle.faults, bench.cycle.mode, bench.cycle.mode_tick = case.fault, Mode.FAULT, bench.tick + 1
    narrator.look()
    return narrator, events


def told(narrator: Narrator) -> Story:
    story = narrator.story()
    assert story is not None
    return story


@pytest.fixture(scope="module")
def under_way() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


@pytest.fixture
def moving(under_way: Bench) -> Iterator[Bench]:
    """Bench in the approach without a fault; its state is restored afterwards."""
    cycle = under_way.cycle
    safety = cycle.parts.safety
    kept = cycle.tick, cycle.parts, cycle.mode_tick
    memory, watched = safety.memory.copy(), safety._watched.copy()
    cycle.faults, cycle.mode = Fault.NONE, Mode.APPROACH
    yield under_way
    cycle.tick, cycle.parts, cycle.mode_tick = kept
    cycle.faults, cycle.mode = Fault.NONE, Mode.APPROACH
    safety.memory[()], safety._watched[:] = memory, watched


@pytest.mark.parametrize("case", CASES, ids=[f"{case.fault.name}-{n}" for n, case in enumerate(CASES)])
def test_fault_report_has_leg_value_and_limit_of_its_tick(moving, case):
    narrator, events = strike(moving, case)
    story = told(narrator)
    found = story.findings
    assert [each.leg for each in found] == [leg for leg, _, _ in case.told]
    for each, (leg, value, limit) in zip(found, case.told, strict=True):
        for seen, true in ((each.value, value), (each.limit, limit)):
            if isinstance(true, float):
                assert seen == pytest.approx(true, rel=1e-5, nan_ok=True)
                assert_says(each, true)
            elif true is not None:
                assert seen == true
                assert str(true) in each.text
        if leg is not None:
            assert re.search(rf"\b(leg|drive) {leg}\b", each.text)
        assert (each.fault, each.tick, each.time_s) == (case.fault.name, moving.tick + 1, each.tick / 1000.0)
        assert each.mode == "APPROACH"
        assert each.next
        assert each.page == f"{GLOSSARY}#fault-{each.fault.lower()}"
    for word in case.words:
        assert word in story.short
    assert_events(events, story)
    assert json.loads(json.dumps(story.fields(), allow_nan=False)) == story.fields()


def assert_says(finding: Finding, value: float) -> None:
    """Check that the text has the number, in SI units or thousandths, to the digits shown."""
    shown = [float(text) for text in NUMBER.findall(finding.text)]
    wanted = [scale * abs(value) for scale in (1.0, 1e3)]
    close = any(abs(abs(n) - w) <= 0.006 * max(w, 1e-3) for n in shown for w in wanted)
    assert close or str(value) in finding.text, (finding.text, value)


def assert_events(events: list[str], story: Story) -> None:
    """Check that each finding was an event: its line, and its fields as JSON."""
    assert len(events) == len(story.findings)
    for event, finding in zip(events, story.findings, strict=True):
        words, _, fields = event.partition("\n")
        assert words == f"error {finding.line}"
        assert json.loads(fields) == finding.fields()


def test_every_fault_is_covered_by_a_fault_report_case_or_a_separate_test():
    others = {Fault.SET_UP, Fault.UNCERTAIN, Fault.CERTIFICATE}
    assert {case.fault for case in CASES} | others == set(Fault)


@pytest.mark.parametrize("pose", [False, True])
def test_broken_lyapunov_certificate_is_reported_with_its_axes(moving, pose):
    safety = moving.cycle.parts.safety
    safety._watched[SCALARS, POSE] = float(pose)
    safety._watch_memory[COUNT] = [0, 2, 3, 3, 4, 1]
    safety._watched[SCALARS, CONFIRM] = 3
    story = told(strike(moving, Case(Fault.CERTIFICATE, {"lyapunov_share": 1.375}, []))[0])
    found = [(each.value, each.limit, each.leg) for each in story.findings]
    assert found == [(1.375, 1.0, None if pose else leg) for leg in (2, 3, 4)]
    turns = f"monitor.disturbance_{'rad' if pose else 'm'}_s2"
    assert [each.limit_key for each in story.findings] == ["monitor.disturbance_m_s2", turns, turns]
    for each, name in zip(
        story.findings, ("z", "rx", "ry") if pose else ("leg 2", "leg 3", "leg 4"), strict=True
    ):
        assert name in each.text
        assert "1.375" in each.text


def test_a_slipped_encoder_and_an_uncertain_pose_are_reported_with_their_limits():
    fusion = VIRTUAL.estimation.fusion.model_copy(update={"may_lose_legs": [1]})
    estimation = VIRTUAL.estimation.model_copy(update={"pose": "fused", "fusion": fusion})
    sensors = VIRTUAL.sensors.model_copy(update={"tracker": TrackerSettings()})
    bench = Bench(VIRTUAL.model_copy(update={"estimation": estimation, "sensors": sensors}))
    bench.until(Mode.APPROACH)
    fused = bench.cycle.parts.fusion
    assert fused is not None
    for name, value in {"contradicting": 1 << 4, "position_std_m": 0.0061, "alone_s": 0.1042}.items():
        fused.record[name] = value
    both = Fault.ENCODER | Fault.UNCERTAIN
    story = told(strike(bench, Case(both, {"innovation_q": legs(0.0, leg_4=-3.3e-4)}, []))[0])
    assert [(each.value, each.limit, each.leg) for each in story.findings] == [
        (3.3e-4, 2e-4, 4),
        (0.0061, 5e-3, None),
        (0.1042, 0.1, None),
    ]
    for text in ("leg 4", "0.330 mm", "6.10 mm", "104 ms"):
        assert text in story.short


def test_all_faults_of_one_tick_are_reported_with_causes_first(moving):
    every = Fault.FOLLOWING | Fault.STALE | Fault.SPEED | Fault.BUS
    columns = {"bus_off": 1, "counted_age": legs(0, leg_1=5), "dq": legs(0.0, leg_3=2.0), "q_d": 9.0}
    story = told(strike(moving, Case(every, columns, []))[0])
    assert story.short.startswith("latched fault BUS, STALE, SPEED, FOLLOWING (")
    assert len(story.next) == 4


def test_fault_whose_cause_is_not_visible_in_its_tick_is_reported_by_name_only(moving):
    assert strike(moving, Case(Fault.SPEED, {"dq": 0.0}, []))[0].short == "latched fault SPEED"
