"""A fault tells its story: leg, value and limit of the tick, what was done, what to do next, a page for each."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.config import TrackerSettings
from drivers.legs.messages import set_up_checksum
from drivers.protocol import DriveSetup
from drivers.signals import DriveFault, DriveState, Fault, Foreign, Mode, Reaction, Stop, Warn
from hil.app.configuration.configuration import load
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, Status
from hil.contracts.records import altered
from hil.loop.story.faults import FAULTS
from hil.loop.story.narrator import Narrator, said
from hil.loop.story.told import DONE, GLOSSARY, DriveSaid, Finding, Story
from hil.safety.certificate import CONFIRM, COUNT, POSE, SCALARS
from hil.signals import Operator
from tests.hil.cycle_bench import Bench
from tests.hil.test_frames import OURS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / GLOSSARY).read_text()
SECTIONS = dict(re.findall(r"^### (\S+ \S+)\n(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL))
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:nan|inf|\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?![\w.])")


# -- the tables -----------------------------------------------------------------------------------------------


def test_every_fault_has_one_row_and_every_row_an_advice():
    assert sorted(row.fault for row in FAULTS) == sorted(Fault)
    assert all(len(row.mend) > 10 for row in FAULTS)


def test_every_mode_has_its_words():
    assert set(DONE) == set(Mode)


def test_the_glossary_has_a_section_for_each_fault_warning_and_stop_and_no_other():
    faults = [f"Fault {member.name}" for member in Fault]
    warnings = [f"Warning {member.name}" for member in Warn]
    stops = [f"Stop {member.name}" for member in Stop if member]
    assert set(SECTIONS) == {*faults, *warnings, *stops}
    for name, text in SECTIONS.items():
        if name.startswith("Fault"):
            assert "\nRule\n: " in text, name
            assert "\nWhat to do\n: " in text, name


def test_the_keys_that_the_glossary_names_are_in_the_configuration():
    schema = (ROOT / "configs/hil.schema.json").read_text()
    for key in re.findall(
        r"`(?:limits|estimation\.fusion|monitor|engage|drives|loop|recording)\.(\w+)`", PAGE
    ):
        assert f'"{key}"' in schema, key


# -- the numbers of the tick -----------------------------------------------------------------------------------


class Case(NamedTuple):
    """A fault, what its tick shows, and what has to be told of it."""

    fault: Fault
    columns: dict[str, Any]
    told: list[tuple[int | None, Any, Any]]
    """Leg, value, limit: SI."""
    words: tuple[str, ...] = ()
    memory: dict[str, Any] = {}
    mode: Mode = Mode.APPROACH


def legs(usual: float, **others: float) -> list[float]:
    """Return six values; others as leg_3=1.5."""
    return [others.get(f"leg_{leg}", usual) for leg in range(6)]


RUN = int(DriveState.RUN)
CASES = [
    Case(Fault.STALE, {"counted_age": legs(0, leg_1=7, leg_4=5)}, [(1, 7, 5), (4, 5, 5)]),
    Case(Fault.STALE, {"counted_age": legs(6)}, [(None, 6, 5)], ("no leg heard", "stalled for 6 ms by then")),
    Case(Fault.STALE, {"counted_age": legs(0, leg_4=5), "legs_slipped": 0b10}, [(4, 5, 5)]),
    Case(
        Fault.STALE,
        {"legs_slipped": 0b10},
        [(1, None, None)],
        ("nothing shows that the brake of leg 1 holds: its encoder has slipped",),
        {"untrusted": 0b1},
    ),
    Case(
        Fault.STALE,
        {"age": legs(0, leg_1=7), "blind": legs(0, leg_1=1)},
        [(1, 7, 5)],
        ("the drive of leg 1 answers, and calls its length invalid for 7 ticks",),
        {"untrusted": 0b1},
    ),
    Case(
        Fault.STALE,
        {"counted_age": legs(5)},
        [(None, 5, 5)],
        (
            "frames were heard and refused (length, check or state) in 6 of the last 32",
            "gateways and bit rates",
        ),
        {"untrusted": 0b1110_10101},
    ),
    Case(
        Fault.STALE,
        {"counted_age": legs(0, leg_2=6)},
        [(2, 6, 5)],
        ("leg 2 was not understood for 6 ticks", "in 2 of the last 32 ticks"),
        {"untrusted": 0b110000},
    ),
    Case(
        Fault.STALE,
        {"counted_age": legs(5)},
        [(None, 5, 5)],
        ("stalled for 5 ms by then",),
        {"untrusted": 0b11100000},
    ),
    Case(
        Fault.DRIVE,
        {
            "drive_state": legs(RUN, leg_3=DriveState.FAULT),
            "drive_fault": legs(0, leg_3=DriveFault.OVERFORCE),
        },
        [(3, "FAULT", "RUN")],
        ("drive 3 in FAULT (OVERFORCE) where RUN was asked for",),
    ),
    Case(
        Fault.DRIVE,
        {"drive_state": legs(RUN, leg_3=DriveState.FAULT), "drive_fault": legs(0, leg_3=0x7301)},
        [(3, "FAULT", "RUN")],
        ("(29441)",),
    ),
    Case(
        Fault.DRIVE,
        {"drive_state": legs(RUN, leg_0=DriveState.OFF)},
        [(0, "OFF", "RUN")],
        ("not on our command",),
        {"running": 1},
    ),
    Case(Fault.DRIVE, {"drive_state": legs(RUN, leg_5=DriveState.BOOT)}, [(5, "BOOT", "RUN")]),
    Case(Fault.BUS, {"bus_off": 1}, [(None, "off", None)], ("the bus is off",)),
    Case(Fault.BUS, {}, [(None, 5, 5)], ("5 ticks in a row",), {"refused": 0b1011111}),
    Case(Fault.BUS, {}, [(None, 8, 8)], ("8 of the last 32",), {"refused": 0b1111011110}),
    Case(
        Fault.STROKE,
        {"q": legs(1.4, leg_2=2.2007, leg_5=0.7481), "dq": 0.0},
        [(2, 2.2007, 2.2), (5, 0.7481, 0.75)],
        ("platform.length_max_m", "platform.length_min_m"),
    ),
    # soft ends 0.02 m inside; 0.0125 m before one, sqrt(2 * 10 * 0.0125) = 0.5 m/s can be stopped
    Case(
        Fault.STROKE,
        {"q": legs(1.4, leg_1=2.1675, leg_4=0.7825), "dq": legs(0.0, leg_1=0.6, leg_4=-0.7)},
        [(1, 0.6, 0.5), (4, 0.7, 0.5)],
        ("limits.deceleration_m_s2", "12.50 mm before"),
    ),
    Case(Fault.SPEED, {"dq": legs(0.1, leg_0=-2.13, leg_3=2.01)}, [(0, 2.13, 2.0), (3, 2.01, 2.0)]),
    # 10 mm, and 10 mm per m/s: at 0.3 m/s 13 mm
    Case(
        Fault.FOLLOWING,
        {"q": 1.4, "q_d": legs(1.4, leg_2=1.4131, leg_4=1.4125), "dq_d": legs(0.0, leg_2=0.3, leg_4=-0.3)},
        [(2, 0.0131, 0.013)],
        ("13.10 mm", "13.00 mm"),
    ),
    Case(
        Fault.FOLLOWING,
        {"q": 1.4, "q_d": 1.4, "dq": legs(0.0, leg_1=-0.031)},
        [(1, 0.031, 0.02)],
        ("still moves",),
    ),
    Case(Fault.KINEMATICS, {"fk_residual": 3.5e-4}, [(None, 3.5e-4, 1e-4)], ("limits.consistency_m is 0.1",)),
    Case(Fault.KINEMATICS, {"fk_residual": inf}, [(None, inf, None)], ("no pose near the last one",)),
    Case(Fault.ASSEMBLY, {"hop": 1.25}, [(None, 1.25, 1.0)]),
    Case(Fault.CONDITION, {"condition": 61.5}, [(None, 61.5, 50.0)]),
    Case(
        Fault.NOT_FINITE,
        {"length": legs(1.4, leg_3=nan), "twist": legs(0.0, leg_5=inf)},
        [(3, nan, "a finite number"), (None, inf, "a finite number")],
        ("length of leg 3 is nan", "twist is inf"),
    ),
    Case(Fault.LAW, {"tau_asked": legs(100.0, leg_2=-inf)}, [(2, -inf, "a finite force")]),
    Case(Fault.ESTOP, {"foreign": 0}, [(None, "asked for at this controller", None)]),
    Case(Fault.ESTOP, {"foreign": int(Foreign.ESTOP)}, [(None, "sent by another node on the bus", None)]),
    Case(
        Fault.SECOND_CONTROLLER,
        {"foreign": int(Foreign.SYNC | Foreign.CONFIG | Foreign.ESTOP)},
        [(None, "SYNC, CONFIG", None)],
    ),
    Case(Fault.DUPLICATE_NODE, {"doubled": 0b100010}, [(1, None, None), (5, None, None)]),
    Case(Fault.REFUSED_FRAMES, {}, [(None, 9, 8)], ("9 of the last 32",), {"untrusted": 0b111111111}),
    Case(
        Fault.BRAKE,
        {"legs_moved": 0b000100, "length": legs(1.4, leg_2=1.4006)},
        [(2, 6e-4, 5e-4)],
        ("leg 2 moved 0.60 mm on its closed brake, limits.standstill_m is 0.5 mm: its brake slipped, or",),
        {"still": np.full(6, 1.4)},
    ),
]


def strike(bench: Bench, case: Case) -> tuple[Narrator, list[str]]:
    """Let a fault strike in the next tick with these columns; return who tells of it, and the events."""
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
def moving() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


@pytest.mark.parametrize("case", CASES, ids=[f"{case.fault.name}-{n}" for n, case in enumerate(CASES)])
def test_a_fault_names_leg_value_and_limit_of_its_tick(moving, case):
    moving.cycle.faults, moving.cycle.mode = Fault.NONE, Mode.APPROACH
    kept, memory = moving.cycle.tick, moving.cycle.parts.safety.memory.copy()
    try:
        narrator, events = strike(moving, case)
        story = told(narrator)
    finally:
        moving.cycle.tick, moving.cycle.parts.safety.memory[()] = kept, memory
    found = story.findings
    assert [each.seen.leg for each in found] == [leg for leg, _, _ in case.told]
    for each, (leg, value, limit) in zip(found, case.told, strict=True):
        for told_, true in ((each.seen.value, value), (each.seen.limit, limit)):
            if isinstance(true, float):
                assert told_ == pytest.approx(true, rel=1e-5, nan_ok=True)
                assert_says(each, true)
            elif true is not None:
                assert told_ == true
                assert str(true) in each.text
        if leg is not None:
            assert re.search(rf"\b(leg|drive) {leg}\b", each.text)
        assert (each.fault, each.tick, each.time_s) == (case.fault.name, moving.tick + 1, each.tick / 1000.0)
        assert each.mode == "APPROACH"
        assert each.mend
        assert f"Fault {each.fault}" in SECTIONS
        assert each.page == f"{GLOSSARY}#fault-{each.fault.lower()}"
    for word in case.words:
        assert word in story.short
    assert_events(events, story)
    assert json.loads(json.dumps(story.fields(), allow_nan=False)) == story.fields()


def test_drives_that_say_the_same_are_one_line(moving):
    moving.cycle.faults, moving.cycle.mode = Fault.NONE, Mode.APPROACH
    kept, memory = moving.cycle.tick, moving.cycle.parts.safety.memory.copy()
    off, lost = int(DriveState.OFF), int(DriveState.FAULT)
    columns = {
        "drive_state": [off, off, lost, off, RUN, off],
        "drive_fault": legs(0, leg_2=DriveFault.STROKE),
    }
    try:
        story = told(strike(moving, Case(Fault.DRIVE, columns, [], (), {"running": 1}))[0])
    finally:
        moving.cycle.tick, moving.cycle.parts.safety.memory[()] = kept, memory
    asked = "where RUN was asked for"
    assert story.short == (
        f"latched fault DRIVE (drive 0, 1 in OFF {asked}: not on our command; drive 2 in FAULT (STROKE) {asked}; "
        f"drive 3, 5 in OFF {asked}: not on our command)"
    )
    assert [each.seen.leg for each in story.findings] == [0, 1, 2, 3, 5]


def test_legs_whose_texts_differ_in_figures_alone_are_one_line_each_with_its_own(moving):
    moving.cycle.faults, moving.cycle.mode = Fault.NONE, Mode.APPROACH
    kept, memory = moving.cycle.tick, moving.cycle.parts.safety.memory.copy()
    columns = {"legs_moved": 0b010110, "length": legs(1.4, leg_1=1.4006, leg_2=1.4007, leg_4=1.4006)}
    try:
        case = Case(Fault.BRAKE, columns, [], (), {"still": np.full(6, 1.4)})
        story = told(strike(moving, case)[0])
    finally:
        moving.cycle.tick, moving.cycle.parts.safety.memory[()] = kept, memory
    assert story.short == (
        "latched fault BRAKE (leg 1, 2, 4 moved 0.60, 0.70, 0.60 mm on its closed brake, limits.standstill_m is 0.5 mm: "
        "its brake slipped, or its encoder did)"
    )
    assert [each.seen.leg for each in story.findings] == [1, 2, 4]


def assert_says(finding: Finding, value: float) -> None:
    """Assert that the text has the number, in SI or in thousandths, to the digits that it shows."""
    shown = [float(text) for text in NUMBER.findall(finding.text)]
    wanted = (abs(value), 1e3 * abs(value))
    close = any(abs(abs(n) - w) <= 0.006 * max(w, 1e-3) for n in shown for w in wanted)
    assert close or str(value) in finding.text, (finding.text, value)


def assert_events(events: list[str], story: Story) -> None:
    """Assert that each finding was an event: its line, and its fields as JSON."""
    assert len(events) == len(story.findings)
    for event, finding in zip(events, story.findings, strict=True):
        words, _, fields = event.partition("\n")
        assert words == f"error {finding.line}"
        assert json.loads(fields) == finding.fields()


def test_all_faults_are_among_these_cases_or_have_a_test_of_their_own():
    others = {Fault.SET_UP, Fault.ENCODER, Fault.UNCERTAIN, Fault.CERTIFICATE}
    assert {case.fault for case in CASES} | others == set(Fault)


@pytest.mark.parametrize("pose", [False, True])
def test_a_broken_certificate_names_its_axes(moving, pose):
    safety = moving.cycle.parts.safety
    watched, memory = safety._watched.copy(), safety.memory.copy()
    kept = moving.cycle.tick
    assert watched.size
    try:
        safety._watched[SCALARS, POSE] = float(pose)
        safety._watch_memory[COUNT] = [0, 2, 3, 3, 4, 1]
        safety._watched[SCALARS, CONFIRM] = 3
        moving.cycle.faults, moving.cycle.mode = Fault.NONE, Mode.APPROACH
        story = told(strike(moving, Case(Fault.CERTIFICATE, {"lyapunov_share": 1.375}, []))[0])
    finally:
        safety._watched[:], moving.cycle.tick, safety.memory[()] = watched, kept, memory
    assert [each.seen[:3] for each in story.findings] == [
        (1.375, 1.0, None if pose else 2),
        (1.375, 1.0, None if pose else 3),
        (1.375, 1.0, None if pose else 4),
    ]
    turns = f"monitor.disturbance_{'rad' if pose else 'm'}_s2"
    assert [each.seen.key for each in story.findings] == ["monitor.disturbance_m_s2", turns, turns]
    if not pose:
        assert "(axis of leg 2, 3, 4 breaks the certificate; the worst axis has 1.375 of" in story.short
    names = ("z", "rx", "ry") if pose else ("of leg 2", "of leg 3", "of leg 4")
    for each, name in zip(story.findings, names, strict=True):
        assert f"axis {name} breaks" in each.text
        assert "1.375" in each.text


def fused() -> Bench:
    c = load("virtual")
    fusion = c.estimation.fusion.model_copy(update={"may_lose_legs": [1]})
    return Bench(
        c.model_copy(
            update={
                "estimation": c.estimation.model_copy(update={"pose": "fused", "fusion": fusion}),
                "sensors": c.sensors.model_copy(update={"tracker": TrackerSettings()}),
            }
        )
    )


def test_of_many_buses_those_that_are_off_are_named(moving):
    moving.cycle.faults, moving.cycle.mode = Fault.NONE, Mode.APPROACH
    kept, parts = moving.cycle.tick, moving.cycle.parts
    moving.cycle.parts = replace(parts, buses=tuple(f"can{leg} (legs {leg})" for leg in range(6)))
    try:
        story = told(strike(moving, Case(Fault.BUS, {"bus_off": 0b101000}, []))[0])
    finally:
        moving.cycle.tick, moving.cycle.parts = kept, parts
    assert "bus can3 (legs 3) and bus can5 (legs 5) is off" in story.short


def test_a_slipped_encoder_and_an_uncertain_pose_are_told_with_their_limits():
    bench = fused()
    bench.until(Mode.APPROACH)
    fusion = bench.cycle.parts.fusion
    assert fusion is not None
    for name, value in {"contradicting": 1 << 4, "position_std_m": 0.0061, "alone_s": 0.1042}.items():
        fusion.record[name] = value
    both = Fault.ENCODER | Fault.UNCERTAIN
    story = told(strike(bench, Case(both, {"innovation_q": legs(0.0, leg_4=-3.3e-4)}, []))[0])
    assert [each.seen[:3] for each in story.findings] == [
        (3.3e-4, 2e-4, 4),
        (0.0061, 5e-3, None),
        (0.1042, 0.1, None),
    ]
    for text in ("leg 4", "0.330 mm", "is 0.2 mm", "6.10 mm", "is 5 mm", "104 ms", "allows 100 ms"):
        assert text in story.short


def test_several_faults_of_one_tick_are_all_named_causes_first(moving):
    moving.cycle.faults, moving.cycle.mode = Fault.NONE, Mode.APPROACH
    kept = moving.cycle.tick
    try:
        every = Fault.FOLLOWING | Fault.STALE | Fault.SPEED | Fault.BUS
        columns = {"bus_off": 1, "counted_age": legs(0, leg_1=5), "dq": legs(0.0, leg_3=2.0), "q_d": 9.0}
        story = told(strike(moving, Case(every, columns, []))[0])
    finally:
        moving.cycle.tick = kept
    assert story.short.startswith("latched fault BUS, STALE, SPEED, FOLLOWING (the bus is off")
    assert len(story.next) == 4


def test_a_fault_that_its_tick_does_not_show_has_its_name(moving):
    moving.cycle.faults, moving.cycle.mode = Fault.NONE, Mode.APPROACH
    kept = moving.cycle.tick
    try:
        narrator, _ = strike(moving, Case(Fault.SPEED, {"dq": 0.0}, []))
    finally:
        moving.cycle.tick = kept
    assert narrator.short == "latched fault SPEED"


# -- what the drives said, and what was done ----------------------------------------------------------------------


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


def go_on(bench: Bench, narrator: Narrator, ticks: int, operator: tuple[Operator, ...] = (), **inputs: Any):
    for _ in range(ticks):
        bench.step(operator, **inputs)
        narrator.look(operator)
        operator = ()
    return told(narrator)


def test_a_bus_that_takes_nothing_is_not_said_to_have_told_the_drives(bench):
    narrator = Narrator(bench.cycle)
    story = go_on(bench, narrator, 40, frames=(), bus_off=True, sends_failed=2)
    assert "could not be told to switch off" in story.done_text
    assert "10 ms after the last command it heard, with reaction `brake`" in story.done_text
    assert "were told" not in "".join(story.lines())
    later = go_on(bench, narrator, 3)
    assert "the drives were told to switch off" in later.done_text
    assert "all six in OFF" in later.done_text
    assert not any("--release" in advice for advice in later.next), "nothing is held"


def test_drives_that_confirm_are_told_from_those_that_do_not(bench):
    narrator = Narrator(bench.cycle)
    bench.drives.silent = {2}
    story = go_on(bench, narrator, 40)
    assert "not all are proven shut; not confirmed by drive 2" in story.done_text
    assert next(iter(story.next)) == "support the platform, then let go of it with `hil run CONFIG --release`"
    assert "all six" not in story.done_text
    assert [(d.leg, d.state, d.age) for d in story.drives if d.age] == [(2, "RUN", 5)]
    assert "drives: 0, 1, 3, 4, 5 RUN; 2 RUN when last heard, 5 ticks ago" in story.lines()
    assert story.at_end == "no leg that is heard moves"
    bench.drives.silent, bench.drives.rate = set(), -0.05
    assert "leg 3 at -0.050 m/s" in go_on(bench, narrator, 1).at_end
    bench.drives.silent = set(range(6))
    assert go_on(bench, narrator, 1).at_end.startswith("no leg is heard")


def test_what_drives_do_on_closed_brakes_and_what_their_maker_says_is_told_as_the_protocol_says(
    bench, monkeypatch
):
    protocol = bench.cycle.parts.protocol
    monkeypatch.setattr(protocol, "traits", replace(protocol.traits, force_on_brakes=False))
    monkeypatch.setattr(protocol, "fault_text", {29441: "EMCY 0x7301, sensor"}.__getitem__)
    narrator = Narrator(bench.cycle)
    bench.drives.silent = {2}
    story = go_on(bench, narrator, 40)
    assert "on which they give no force: nothing else holds the platform" in story.done_text
    assert "force held" not in story.done_text
    assert DriveSaid(4, "FAULT", 29441, 0, "EMCY 0x7301, sensor").text == "FAULT (29441: EMCY 0x7301, sensor)"
    bench.cycle.tick["drive_fault"][4] = 29441
    assert said(bench.cycle)[4].meaning == "EMCY 0x7301, sensor"


@pytest.mark.parametrize("deaf", [(), (4,), (0, 4)])
def test_an_emergency_stop_says_who_confirmed_it(bench, deaf):
    narrator = Narrator(bench.cycle)
    go_on(bench, narrator, 1, (Operator.ESTOP,))
    for leg in range(6):
        if leg not in deaf:
            bench.drives.state[leg] = DriveState.FAULT
            holds = Configure(leg, 0.01, Reaction.BRAKE)
            bench.drives.statuses += reports(OURS, Status(leg, DriveState.FAULT, DriveFault.ESTOP, holds))
    story = go_on(bench, narrator, 20)
    if deaf:
        assert f"sent in 21 ticks; not confirmed by drive {', '.join(map(str, deaf))}" in story.done_text
    else:
        assert "sent in 1 ticks, until all six drives confirmed it" in story.done_text


def test_the_modes_that_followed_are_what_was_done(bench):
    """Whatever the reaction is: each mode that was entered is one step, in its tick."""
    narrator = Narrator(bench.cycle)
    cycle = bench.cycle
    cycle.parts.safety.memory["untrusted"] = 0xFF
    cycle.faults = Fault.REFUSED_FRAMES
    entered = [Mode.STOPPING, Mode.PARKING, Mode.UNLOADING, Mode.PARKED]
    for n, mode in enumerate(entered):
        cycle.tick = altered(cycle.tick, tick=bench.tick + 10 * n)
        cycle.mode, cycle.proven = mode, mode is Mode.PARKED
        narrator.look()
    cycle.tick = altered(cycle.tick, tick=bench.tick + 40, drive_state=int(DriveState.OFF))
    narrator.look()
    story = told(narrator)
    assert [step.mode for step in story.done] == [mode.name for mode in entered]
    assert [step.tick - bench.tick for step in story.done] == [0, 10, 20, 30]
    assert [step.text for step in story.done[:3]] == [DONE[mode] for mode in entered[:3]]
    assert story.done[3].text.endswith("all six in OFF 10 ms later; the brakes had passed their test")


def test_a_release_is_told_as_one(bench):
    narrator = Narrator(bench.cycle)
    cycle = bench.cycle
    cycle.faults, cycle.mode = Fault.BRAKE, Mode.HELD
    narrator.look()
    assert "not all are proven shut" in told(narrator).done_text
    assert any("--release" in advice for advice in told(narrator).next)
    cycle.mode = Mode.FAULT
    narrator.look((Operator.RELEASE,))
    assert told(narrator).done[-1].text.startswith("the platform was released on request; ")
    assert not any("--release" in advice for advice in told(narrator).next), "nothing is held any more"


def test_a_reset_ends_the_story_and_the_next_fault_has_its_own(bench):
    narrator = Narrator(bench.cycle)
    go_on(bench, narrator, 1, (Operator.ESTOP,))
    bench.step((Operator.RESET,))
    narrator.look((Operator.RESET,))
    assert narrator.story() is None
    bench.until(Mode.IDLE)
    bench.step((Operator.ESTOP,))
    narrator.look((Operator.ESTOP,))
    assert [each.tick for each in told(narrator).findings] == [bench.tick]


def test_a_drive_that_does_not_follow_is_named_with_the_time_that_it_had():
    """LOADING takes the brake test and the ramp, 0.3 s each, and a drive has 1 s more."""
    bench = Bench()
    narrator = Narrator(bench.cycle)
    bench.until(Mode.IDLE)
    narrator.look()
    obey = bench.drives.obey

    def all_but_one(frames):
        obey(frames)
        bench.drives.state[3] = DriveState.OFF

    bench.drives.obey = all_but_one  # type: ignore[method-assign]
    operator: tuple[Operator, ...] = (Operator.ENGAGE,)
    while bench.cycle.mode is not Mode.FAULT:
        bench.step(operator)
        narrator.look(operator)
        operator = ()
    (finding,) = told(narrator).findings
    assert (finding.fault, finding.seen.leg, finding.mode) == ("DRIVE", 3, "LOADING")
    assert (
        "drive 3 in OFF where READY was asked for, 1.60 s after it was asked; 1.60 s are allowed"
        in finding.text
    )


def test_a_drive_that_followed_in_the_very_tick_in_which_it_was_too_late_is_named(moving):
    cycle = moving.cycle
    kept = cycle.tick, cycle.mode_tick
    ready, off = int(DriveState.READY), int(DriveState.OFF)
    cycle.faults, cycle.mode = Fault.NONE, Mode.LOADING
    cycle.mode_tick = int(cycle.tick["tick"]) + 1 - 1601
    cycle.tick = altered(cycle.tick, drive_state=legs(ready, leg_3=off))
    try:
        story = told(strike(moving, Case(Fault.DRIVE, {"drive_state": ready}, []))[0])
    finally:
        cycle.tick, cycle.mode_tick = kept
    assert [each.seen[:3] for each in story.findings] == [("OFF", "READY", 3)]


def test_a_drive_that_does_not_obey_after_another_fault_is_told_with_the_force_of_the_tick_before(moving):
    cycle = moving.cycle
    kept, memory = cycle.tick, cycle.parts.safety.memory.copy()
    cycle.faults, cycle.mode = Fault.NONE, Mode.APPROACH
    later: list[tuple[Fault, dict[str, Any]]] = [
        (Fault.STALE, {"tau": legs(0, leg_2=333)}),
        (Fault.STALE | Fault.DRIVE, {"legs_refused": 1 << 2}),
    ]
    try:
        narrator, _ = strike(moving, Case(Fault.STALE, {"counted_age": legs(0, leg_1=7)}, []))
        for faults, columns in later:
            cycle.last = cycle.tick
            cycle.tick = altered(
                cycle.tick, **{"tick": int(cycle.tick["tick"]) + 1, "tau": legs(7)} | columns
            )
            cycle.faults = faults
            narrator.look()
    finally:
        cycle.tick = kept
        cycle.parts.safety.memory[...] = memory
    stale, refused = told(narrator).findings
    assert (stale.seen.leg, refused.seen.leg) == (1, 2)
    assert "drive 2 does not obey: at +333 N" in refused.text


# -- a set-up that is not confirmed --------------------------------------------------------------------------------

CONFIG = OURS.configure(0.01, Reaction.BRAKE)[3]
"""10,000 us, reaction 0, slot 4, version 2."""


@pytest.mark.parametrize(("place", "value"), [(0, 0x11), (4, 3), (5, 1), (6, 1)])
def test_different_set_up_is_reported_with_both_checksums(place, value):
    other = bytearray(CONFIG.data[:-1])
    assert bytes(other) == bytes([0x10, 0x27, 0, 0, 0, 4, 2])
    other[place] = value
    end = OURS.controller_end(DriveSetup(0.01, Reaction.BRAKE, 1000.0))
    said, sent = (set_up_checksum(CONFIG.id, bytes(each), 30e3) for each in (other, CONFIG.data[:-1]))
    end.state["said"], end.state["sent"] = said, 10
    assert f"checksum 0x{said:04X}, not 0x{sent:04X}" in end.lacks()[3]


@pytest.mark.parametrize("reaction", [Reaction.DAMP, Reaction.HOLD, Reaction.ZERO])
def test_a_drive_that_was_set_up_by_somebody_else_is_told_with_the_value(bench, reaction):
    narrator = Narrator(bench.cycle)
    other = Configure(4, 0.01, reaction)
    bench.drives.statuses += reports(OURS, Status(4, bench.drives.state[4], 0, other))
    story = go_on(bench, narrator, 1)
    said = bench.cycle.end.lacks()[4]
    assert "its set-up has checksum 0x" in said
    assert (
        story.short
        == f"latched fault SET_UP (drive 4 reports another set-up than the one sent to it: {said})"
    )
    assert story.findings[0].seen.leg == 4
