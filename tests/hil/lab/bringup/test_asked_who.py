"""Asking drives who they are: lost frames, wrong buses, numbers that nobody wrote, answers of no sense."""

from __future__ import annotations

import copy
import struct
from math import inf, nan
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.moteus import FAULT, MODE, PLACE, SERIAL_NUMBER, SPEED, TORQUE, MoteusProtocol, pad
from drivers.motors import MotorProtocol
from drivers.protocol import BRS, BUS, ERROR, EXTENDED, FD, REMOTE, REVISION, SERIAL, Frame, Said
from hil.app.compose import build_protocol
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.lab.bringup.context import Context
from hil.lab.bringup.drives import ASKED_TIMES
from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.steps import scan
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.broad import broad
from tests.drivers.motor_families import Motors
from tests.hil.lab.bringup.families import family
from tests.hil.lab.bringup.kit import Rehearsal, named

ASKED = ("cia402_pdo", "damiao", "robstride", "odrive", "moteus_stopped")
SCAN, BY_HAND = STEPS[:1], STEPS[:4]
MOTEUS: Any = build_protocol(family("moteus_stopped"))
assert isinstance(MOTEUS, MoteusProtocol)


class LossyLine:
    """A line that loses the first answers of each drive to who it is."""

    def __init__(self, rehearsal: Rehearsal, lost: int) -> None:
        self._line = rehearsal.drives.line
        self._protocol = rehearsal.drives.protocol
        self._left = dict.fromkeys(range(6), lost)
        self.answers: list[Frame] = []
        self.requests = 0
        self.rate_Hz = self._line.rate_Hz
        requests = self._protocol.traits.identity_requests
        self._asking = {frame for asked in requests for frame in asked}

    def exchange(self, opening):
        heard = self._line.exchange(opening)
        kept = []
        for received in heard.frames:
            said = self._protocol.identity(received.frame)
            if said is not None:
                self.answers.append(received.frame)
                self._left[said.leg] -= 1
            if said is None or self._left[said.leg] < 0:
                kept.append(received)
        return heard._replace(frames=tuple(kept))

    def send(self, frames):
        self.requests += sum(frame in self._asking for frame in frames)
        self._line.send(frames)


def asked_over(name, lost):
    rehearsal = Rehearsal(name, Wiring())
    line = LossyLine(rehearsal, lost)
    rehearsal.drives.line = line
    return rehearsal.drives.identities(), line


@pytest.mark.parametrize("name", ["damiao", "odrive"])
def test_a_drive_whose_answers_are_lost_is_asked_again_and_one_that_has_answered_is_not(name):
    rounds = {"damiao": 2, "odrive": 1}[name]
    whole, line = asked_over(name, 0)
    assert line.requests == 6 * rounds
    late, line = asked_over(name, ASKED_TIMES - 1)
    assert late == whole
    assert [who[SERIAL] for who in whole] == [1, 2, 3, 4, 5, 6]
    never, line = asked_over(name, 100)
    assert never == ({},) * 6
    assert line.requests == 6 * rounds * ASKED_TIMES


@pytest.mark.long
@pytest.mark.parametrize("name", ["damiao", "odrive"])
def test_a_drive_that_is_not_heard_is_not_asked_who_it_is(name):
    rehearsal = Rehearsal(name, wired(Mistake("absent", 3)))
    line = LossyLine(rehearsal, 0)
    rehearsal.drives.line = line
    assert named(rehearsal.run(SCAN)) == {("absent", (3,))}
    assert line.requests == 5 * {"damiao": 2, "odrive": 1}[name]
    assert rehearsal.context.facts["identity"].keys() == set("01245")


class TwinLine(LossyLine):
    """A line with a second drive of one number behind it, at the same length: it differs by its serial number."""

    def __init__(self, rehearsal: Rehearsal, leg: int, name: str) -> None:
        super().__init__(rehearsal, 0)
        self._leg, self._lowest = leg, _LOWEST[name]

    def exchange(self, opening):
        heard = super().exchange(opening)
        frames = list(heard.frames)
        for each in heard.frames:
            said = self._protocol.identity(each.frame)
            if said is not None and said.leg == self._leg and said.what == SERIAL:
                data = bytearray(each.frame.data)
                data[self._lowest] += 32
                frames.append(each._replace(frame=each.frame._replace(data=bytes(data))))
        return heard._replace(frames=tuple(frames))


_LOWEST = {"damiao": 4, "odrive": 1, "robstride": 0, "cia402_pdo": 4}
"""Where in an answer the lowest byte of a serial number is."""


@pytest.mark.parametrize("name", broad([*_LOWEST], quick=2))
def test_two_serial_numbers_of_one_node_are_two_drives(name):
    rehearsal = Rehearsal(name, Wiring())
    rehearsal.drives.line = TwinLine(rehearsal, 2, name)
    outcome = rehearsal.run(SCAN)
    assert named(outcome) == {("same_id", (2,))}
    assert "two drives answer as node 3, with serial numbers 3, 35" in outcome.findings[0].line
    assert "2" not in rehearsal.context.facts["identity"]


def test_of_two_drives_of_one_node_none_is_taken_for_an_exchanged_one():
    said = tuple({SERIAL: 35 if leg == 2 else leg + 1} for leg in range(6))
    serials = [{3, 35} if leg == 2 else {leg + 1} for leg in range(6)]
    drives = SimpleNamespace(identities=lambda _: said, serials=serials)
    identity = {str(leg): {SERIAL: leg + 1} for leg in range(6)}
    seen = {str(leg): {"twice": False, "answers": 1.0} for leg in range(6)}
    facts: dict[str, Any] = {"identity": identity, "scan": seen, "encoder": {"2": {"drive": 2}}}
    known = copy.deepcopy(facts)
    known["scan"]["2"]["twice"] = True
    c = SimpleNamespace(
        drives=drives,
        facts=facts,
        machine=SimpleNamespace(node_ids=range(1, 7)),
        operator=SimpleNamespace(tell=pytest.fail),
        save=lambda: None,
        known=lambda step, leg: facts[step].get(str(leg)),
        keep=lambda step, leg, fact: facts[step].update({str(leg): fact}),
    )
    scan._recognise(cast("Context", c), range(6))
    assert facts == known


@pytest.mark.parametrize("name", broad(["cubemars", "cia402_pdo", "odrive"], quick=1))
def test_two_drives_of_one_number_and_one_length_answer_too_often(name):
    """An axis of odrive is set to send nothing unasked."""
    unasked = {"drives": {"options": {"encoder_msg_rate_ms": 0}}} if name == "odrive" else {}
    c = family(name)
    c = loads(with_changes(c.text, unasked), name, c.folder)
    rehearsal = Rehearsal(c, wired(Mistake("same_id", 5, 2)))
    legs = rehearsal.bench._legs
    legs.place(5, rehearsal.bench.length(2))
    legs.reset = lambda: (legs.legs["x"].copy(), np.zeros(6))  # type: ignore[method-assign]
    rehearsal.bench.nodes.start(0)
    assert named(rehearsal.run(SCAN)) == {("same_id", (2, 5))}


@pytest.mark.parametrize("name", ASKED)
def test_an_answer_counts_only_as_it_is_sent_and_on_the_bus_of_its_drive(name):
    protocol = build_protocol(family(name))
    _, line = asked_over(name, 0)
    halves = [{"channel": "a", "legs": [0, 1, 2]}, {"channel": "b", "legs": [3, 4, 5]}]
    c = family(name)
    text = with_changes(c.text, {"bus": {"channel": None, "channels": halves}})
    two = build_protocol(loads(text, name, c.folder))
    assert len(line.answers) >= 6
    for frame in line.answers:
        said = protocol.identity(frame)
        assert said is not None
        for flag in (ERROR, REMOTE, BUS):
            assert protocol.identity(frame._replace(flags=frame.flags | flag)) is None, flag
        own = said.leg // 3
        for bus in range(3):
            on = frame._replace(flags=frame.flags + BUS * bus)
            assert two.identity(on) == (said if bus == own else None)


def measured():
    rehearsal = Rehearsal("odrive", Wiring())
    assert rehearsal.run(BY_HAND).success
    return rehearsal.context.facts


def scanned(facts, said, monkeypatch):
    """Scan where the drives say this of themselves; return the rehearsal and what the operator was told."""
    rehearsal = Rehearsal("odrive", Wiring(), facts=copy.deepcopy(facts))
    told: list[str] = []
    monkeypatch.setattr(rehearsal.hands, "tell", told.append)
    monkeypatch.setattr(rehearsal.drives, "identities", lambda _: said)
    rehearsal.drives.serials = tuple(set[int]() for _ in range(6))
    return rehearsal, told


def test_a_drive_that_does_not_tell_is_no_other_one_and_stays_known(monkeypatch):
    facts = measured()
    silent = tuple({} if leg == 2 else {SERIAL: leg + 1} for leg in range(6))
    rehearsal, told = scanned(facts, silent, monkeypatch)
    rehearsal.run(SCAN)
    found = rehearsal.context.facts
    assert found["identity"] == facts["identity"]
    assert found["encoder"].keys() == set("012345")
    (line,) = [each for each in told if "leg 2" in each]
    assert "has not told its serial number, which was 3" in line
    assert "--again" in line


def test_a_figure_that_is_told_only_now_is_kept_and_changes_nothing(monkeypatch):
    facts = measured()
    more = tuple({SERIAL: leg + 1, REVISION: 7} for leg in range(6))
    rehearsal, told = scanned(facts, more, monkeypatch)
    rehearsal.run(SCAN)
    assert rehearsal.context.facts["identity"]["4"] == {SERIAL: 5, REVISION: 7}
    assert rehearsal.context.facts["encoder"].keys() == set("012345")
    assert not [each for each in told if "leg" in each]


def test_a_blank_serial_number_that_was_kept_is_compared_with_none(monkeypatch):
    facts = measured()
    facts["identity"]["2"] = {SERIAL: 0}
    facts["identity"]["3"] = {SERIAL: 0xFFFFFFFF}
    who = tuple({} if leg == 3 else {SERIAL: leg + 1} for leg in range(6))
    rehearsal, told = scanned(facts, who, monkeypatch)
    rehearsal.run(SCAN)
    assert not [each for each in told if "leg" in each]
    assert rehearsal.context.facts["encoder"].keys() == set("012345")
    assert rehearsal.context.facts["identity"]["2"] == {SERIAL: 3}


def test_what_is_known_of_a_leg_is_dropped_before_its_new_drive_is_known(monkeypatch):
    other = tuple({SERIAL: 77 if leg == 2 else leg + 1} for leg in range(6))
    rehearsal, told = scanned(measured(), other, monkeypatch)
    saved: list[dict[str, Any]] = []
    rehearsal.context.save = lambda: saved.append(copy.deepcopy(rehearsal.context.facts))
    rehearsal.run(SCAN)
    assert [each for each in told if "serial number 3 -> 77" in each]
    new = [facts for facts in saved if facts["identity"]["2"] == {SERIAL: 77}]
    assert new
    assert not [facts for facts in new if "2" in facts["encoder"]]
    assert [facts for facts in saved if "2" not in facts["encoder"] and facts["identity"]["2"] == {SERIAL: 3}]


@pytest.mark.parametrize("value", [0, 0xFFFFFFFF, (1 << 48) - 1, (1 << 64) - 1, (1 << 96) - 1])
def test_a_serial_number_that_was_never_written_tells_nothing(value, monkeypatch):
    assert not Said(0, SERIAL, value).tells
    assert Said(0, SERIAL, value ^ 0x10).tells
    assert Said(0, REVISION, value).tells
    rehearsal = Rehearsal("odrive", Wiring())
    protocol: Any = type(rehearsal.drives.protocol)
    heard = protocol.identity

    def blank(self, frame):
        said = heard(self, frame)
        return said if said is None else said._replace(value=value)

    monkeypatch.setattr(protocol, "identity", blank)
    assert rehearsal.drives.identities() == ({},) * 6


def reply(values):
    """Return a reply of the moteus of leg 0 by its layout: each register by itself, as a float."""
    data = b""
    for register, value in values.items():
        place = bytes((register,)) if register < 128 else bytes((register & 0x7F | 0x80, register >> 7))
        data += bytes((0x20 | 3 << 2 | 1, *place)) + struct.pack("<f", value)
    return Frame(MOTEUS.wanted[0], pad(data), FD | BRS | EXTENDED * (MOTEUS.wanted[0] > 0x7FF))


WELL = {MODE: 10.0, PLACE: 0.5, SPEED: 0.0, TORQUE: 1.0, FAULT: 0.0}


@pytest.mark.parametrize(
    "wrong",
    [
        *({MODE: value} for value in (nan, inf, 10.5, 1e30, -1.0)),
        *({MODE: 1.0, FAULT: value} for value in (nan, -inf, 1e20)),
        *({figure: value} for figure in (PLACE, SPEED, TORQUE) for value in (inf, -inf)),
    ],
)
def test_a_moteus_reply_with_figures_of_no_sense_is_a_broken_one(wrong):
    good = Motors(MOTEUS).hear(reply(WELL))
    assert good is not None
    assert (good.motion, good.torque, good.broken) == ((0.5, 0.0), 1.0, False)
    heard = Motors(MOTEUS).hear(reply(WELL | wrong))
    assert heard is not None
    assert heard.broken
    assert not heard.feedback


@pytest.mark.parametrize("wrong", [nan, inf, -inf, 0.5])
def test_a_moteus_serial_number_of_no_sense_is_none(wrong):
    words = {SERIAL_NUMBER: 5.0, SERIAL_NUMBER + 1: 0.0, SERIAL_NUMBER + 2: 1.0}
    assert MOTEUS.identity(reply(words)) == Said(0, SERIAL, 1 << 64 | 5)
    frame = reply(words | {SERIAL_NUMBER + 1: wrong})
    assert MOTEUS.identity(frame) is None
    heard = Motors(MOTEUS).hear(frame)
    assert heard is not None
    assert heard.broken


@pytest.mark.parametrize("name", ASKED)
@given(data=st.data())
def test_no_frame_of_a_drive_raises(name, data):
    protocol = build_protocol(family(name))
    lines = cyclic(name)
    example = data.draw(st.sampled_from(lines))
    place = data.draw(st.integers(0, len(example.data)))
    noise = data.draw(st.binary(max_size=8))
    wrong = (example.data[:place] + noise + example.data[place + len(noise) :])[: len(example.data)]
    frame = example._replace(data=wrong)
    said = protocol.identity(frame)
    assert said is None or 0 <= said.leg < 6
    assert -1 <= protocol.sender(frame) < 6
    if isinstance(protocol, MotorProtocol):
        heard = Motors(protocol).hear(frame)
        assert heard is None or 0 <= heard.leg < 6


def cyclic(name, _known={}):  # noqa: B006 - asked once
    if name not in _known:
        _, line = asked_over(name, 0)
        frames = build_protocol(family(name)).traits.cyclic_frames
        _known[name] = [*line.answers, *frames]
    return _known[name]
