"""Who each drive is: asked again where answers are lost, two drives on one number, a drive that was exchanged."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from drivers.cia402 import objects
from drivers.mit.robstride import RobStrideProtocol
from drivers.odrive import ODriveProtocol
from drivers.protocol import EXTENDED, REMOTE, REVISION, SERIAL, Frame, Said
from hil.app.compose import build_protocol
from hil.lab.bringup.drives import ASKED_TIMES
from hil.lab.bringup.procedure import STEPS
from plant_fmu.drives.cia402_dictionary import PLACE, defaults
from tests.broad import broad
from tests.hil.lab.bringup.families import FAMILIES, family
from tests.hil.lab.bringup.kit import Rehearsal, named

SCAN, BY_HAND = STEPS[:1], STEPS[:4]


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
    rehearsal = Rehearsal(name)
    line = LossyLine(rehearsal, lost)
    rehearsal.drives.line = line
    return rehearsal.drives.identities(), line


@pytest.mark.parametrize("name", ["damiao", "odrive"])
def test_only_drives_whose_answers_are_lost_are_requested_again(name):
    rounds = {"damiao": 2, "odrive": 1}[name]
    whole, line = asked_over(name, 0)
    assert line.requests == 6 * rounds
    late, line = asked_over(name, ASKED_TIMES - 1)
    assert late == whole
    assert [who[SERIAL] for who in whole] == [1, 2, 3, 4, 5, 6]
    never, line = asked_over(name, 100)
    assert never == ({},) * 6
    assert line.requests == 6 * rounds * ASKED_TIMES


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
    rehearsal = Rehearsal(name)
    rehearsal.drives.line = TwinLine(rehearsal, 2, name)
    outcome = rehearsal.run(SCAN)
    assert named(outcome) == {("same_id", (2,))}
    assert "2" not in rehearsal.context.facts["identity"]


def measured():
    rehearsal = Rehearsal("odrive")
    assert rehearsal.run(BY_HAND).success
    return rehearsal.context.facts


def scanned(facts, said, monkeypatch):
    """Scan where the drives say this of themselves; return the rehearsal and what the operator was told."""
    rehearsal = Rehearsal("odrive", facts=copy.deepcopy(facts))
    told: list[str] = []
    monkeypatch.setattr(rehearsal.hands, "tell", told.append)
    monkeypatch.setattr(rehearsal.drives, "identities", lambda _: said)
    rehearsal.drives.serials = tuple(set[int]() for _ in range(6))
    return rehearsal, told


CHANGES = {
    "silent": ({}, {SERIAL: 3}, True),
    "another": ({SERIAL: 77}, {SERIAL: 77}, False),
    "one more figure": ({SERIAL: 3, REVISION: 7}, {SERIAL: 3, REVISION: 7}, True),
}
"""What drive 2 tells in the next session, what is known of it then, and whether its facts stay."""


@pytest.mark.parametrize("case", CHANGES)
def test_facts_of_a_drive_go_with_its_number_and_stay_where_it_is_silent(case, monkeypatch):
    tells, known, stay = CHANGES[case]
    others = tuple(tells if leg == 2 else {SERIAL: leg + 1} for leg in range(6))
    rehearsal, _ = scanned(measured(), others, monkeypatch)
    saved: list[dict[str, Any]] = []
    rehearsal.context.save = lambda: saved.append(copy.deepcopy(rehearsal.context.facts))
    rehearsal.run(SCAN)
    facts = rehearsal.context.facts
    assert facts["identity"]["2"] == known
    assert facts["encoder"].keys() == set("012345" if stay else "01345")
    if not stay:
        assert [
            facts for facts in saved if "2" not in facts["encoder"] and facts["identity"]["2"] == {SERIAL: 3}
        ]
        assert not [facts for facts in saved if "2" in facts["encoder"] and facts["identity"]["2"] == known]


def asked_legs(rehearsal):
    return {request.leg for request in rehearsal.hands.requests if request.act == "measure"}


def with_another(monkeypatch, node, key, value):
    """Let the drive of a node be another one, by one object of its dictionary."""

    def of_one(n, *figures):
        values = defaults(n, *figures)
        if n == node:
            values[PLACE[key]] = value
        return values

    monkeypatch.setattr("plant_fmu.drives.cia402_dictionary.defaults", of_one)


@pytest.mark.parametrize(
    ("key", "told"),
    broad([(objects.SERIAL, "serial number 3 -> 77"), (objects.REVISION, "revision 1 -> 77")], quick=1),
)
def test_exchanged_drive_alone_is_measured_again(monkeypatch, key, told):
    first = Rehearsal("cia402_pdo")
    assert first.run(STEPS[:4]).success
    facts = first.context.facts
    assert facts["identity"]["2"] == {"serial number": 3, "revision": 1}

    again = Rehearsal("cia402_pdo", facts=copy.deepcopy(facts))
    said: list[str] = []
    monkeypatch.setattr(again.hands, "tell", said.append)
    assert again.run(STEPS[:4]).success
    assert asked_legs(again) == set()
    assert not any("another drive" in text for text in said)

    with_another(monkeypatch, 3, key, 77)
    third = Rehearsal("cia402_pdo", facts=copy.deepcopy(facts) | {"mounted": {"0": {}}})
    monkeypatch.setattr(third.hands, "tell", said.append)
    assert third.run(STEPS[:4]).success
    assert asked_legs(third) == {2}
    assert [text for text in said if told in text]
    assert "mounted" not in third.context.facts
    assert third.context.facts["watchdog"].keys() == set("012345")


def requests_of(name):
    protocol = build_protocol(family(name))
    return protocol.traits.identity_requests


def test_each_family_with_identities_reports_them():
    told = {}
    for name in ("cia402_pdo", "robstride", "odrive", "damiao", "moteus_stopped", "cubemars", "legs_fd"):
        rehearsal = Rehearsal(name)
        told[name] = rehearsal.drives.identities()
    assert told["cia402_pdo"][4] == {"serial number": 5, "revision": 1}
    assert [who["serial number"] for who in told["robstride"]] == [1, 2, 3, 4, 5, 6]
    assert [who["serial number"] for who in told["odrive"]] == [1, 2, 3, 4, 5, 6]
    assert told["moteus_stopped"][4] == {"serial number": 5, "revision": 0x010000}
    assert told["damiao"][5] == {"serial number": 6, "revision": 1}
    assert told["cubemars"] == told["legs_fd"] == ({},) * 6
    silent = {name for name in FAMILIES if not requests_of(name)}
    assert silent == {"legs_fd", "legs_classic", "cubemars", "mini_cheetah"}


def test_serial_numbers_are_read_as_their_makers_write_them():
    """ODrive: tests/data/drives/odrive.json, 0.6: Address. RobStride: type 0 from motor 5 to 0xFE."""
    odrive = build_protocol(family("odrive"))
    robstride = build_protocol(family("robstride"))
    assert isinstance(odrive, ODriveProtocol)
    assert isinstance(robstride, RobStrideProtocol)
    said = odrive.identity(Frame(5 << 5 | 6, bytes.fromhex("05ab896745230107")))
    assert said == Said(4, "serial number", 1250999896491)
    assert odrive.identity(Frame(5 << 5 | 6, bytes.fromhex("3fab896745230107"))) is None, (
        "gives it another number"
    )
    assert odrive.traits.identity_requests[0][4] == Frame(5 << 5 | 6, b"", REMOTE)
    assert robstride.identity(Frame(0x0005FE, (1 << 60 | 7).to_bytes(8, "little"), EXTENDED)) == Said(
        4, "serial number", 1 << 60 | 7
    )
    assert robstride.traits.identity_requests[0][0].id == 0xFD01
    to_the_host = Frame(0x0005FD, (7).to_bytes(8, "little"), EXTENDED)
    assert robstride.identity(to_the_host) == Said(4, "serial number", 7)
    assert robstride.identity(Frame(0x00FD01, bytes(8), EXTENDED)) is None
