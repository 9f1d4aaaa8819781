"""Identity of the drives: repeated requests, two drives on one node number, and replaced drives."""

from __future__ import annotations

import copy
from itertools import count
from typing import Any

import pytest

from drivers.cia402 import objects
from drivers.protocol import REVISION, SERIAL, Frame
from hil.lab.bringup.drives import MOST_REQUESTS
from hil.lab.bringup.procedure import STEPS
from plant_fmu.drives.cia402_dictionary import PLACE, defaults
from tests.broad import broad
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

SCAN, BY_HAND = STEPS[:1], STEPS[:4]


def asked_over(name, lost):
    """Request identities while the first `lost` answers are lost.

    Return the identities and number of requests.
    """
    rehearsal, left = Rehearsal(name), dict.fromkeys(range(6), lost)
    protocol, line = rehearsal.drives.protocol, rehearsal.drives.line
    asking = {frame for asked in protocol.traits.identity_requests for frame in asked}
    sent: list[Frame] = []
    send = line.send

    def sends(frames):
        sent.extend(frame for frame in frames if frame in asking)
        send(frames)

    def lossy(heard, _):
        kept = []
        for received in heard.frames:
            said = protocol.identity(received.frame)
            if said is not None:
                left[said.leg] -= 1
            if said is None or left[said.leg] < 0:
                kept.append(received)
        return heard._replace(frames=tuple(kept))

    line.send = sends  # type: ignore[method-assign]
    rehearsal.hears(lossy)
    return rehearsal.drives.identities(), len(sent)


@pytest.mark.parametrize("name", ["damiao", "odrive"])
def test_identity_request_is_repeated_only_to_drives_that_did_not_answer(name):
    rounds = {"damiao": 2, "odrive": 1}[name]
    whole, requests = asked_over(name, 0)
    assert requests == 6 * rounds
    late, _ = asked_over(name, MOST_REQUESTS - 1)
    assert late == whole
    assert [who[SERIAL] for who in whole] == [1, 2, 3, 4, 5, 6]
    never, requests = asked_over(name, 100)
    assert never == ({},) * 6
    assert requests == 6 * rounds * MOST_REQUESTS


_LOWEST = {"damiao": 4, "odrive": 1, "robstride": 0, "cia402_pdo": 4}
"""Index of the lowest byte of the serial number in an answer."""


@pytest.mark.parametrize("name", broad([*_LOWEST], quick=2))
def test_two_serial_numbers_from_one_node_are_two_drives(name):
    """The second drive reads the same length and differs only in its serial number."""
    rehearsal = Rehearsal(name)

    def twin(heard, _):
        frames = list(heard.frames)
        for each in heard.frames:
            said = rehearsal.drives.protocol.identity(each.frame)
            if said is not None and said.leg == 2 and said.what == SERIAL:
                data = bytearray(each.frame.data)
                data[_LOWEST[name]] += 32
                frames.append(each._replace(frame=each.frame._replace(data=bytes(data))))
        return heard._replace(frames=tuple(frames))

    rehearsal.hears(twin)
    outcome = rehearsal.run(SCAN)
    assert named(outcome) == {("same_id", (2,))}
    assert "2" not in rehearsal.context.facts["identity"]


def measured():
    rehearsal = Rehearsal("odrive")
    assert rehearsal.run(BY_HAND).success
    return rehearsal.context.facts


def scanned(facts, said, monkeypatch):
    """A rehearsal in which the drives report these identities, and the list of texts for the operator."""
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
"""Identity reported by drive 2 in the next session, the stored identity after it, and whether facts are kept."""


@pytest.mark.parametrize("case", CHANGES)
def test_measurements_are_discarded_only_if_a_drive_reports_another_serial_number(case, monkeypatch):
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
    """Give the drive of a node another value of one object in its dictionary."""

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
def test_bring_up_repeats_the_measurements_of_a_replaced_drive_only(monkeypatch, key, told):
    first = Rehearsal("cia402_pdo")
    assert first.run(STEPS[:4]).success
    facts = first.context.facts
    assert facts["identity"]["2"] == {"serial number": 3, "revision": 1}

    again = Rehearsal("cia402_pdo", facts=copy.deepcopy(facts))
    said: list[str] = []
    monkeypatch.setattr(again.hands, "tell", said.append)
    assert again.run(STEPS[:4]).success
    assert asked_legs(again) == set()
    assert not any("other drive" in text for text in said)

    with_another(monkeypatch, 3, key, 77)
    third = Rehearsal("cia402_pdo", facts=copy.deepcopy(facts) | {"mounted": {"0": {}}})
    monkeypatch.setattr(third.hands, "tell", said.append)
    assert third.run(STEPS[:4]).success
    assert asked_legs(third) == {2}
    assert [text for text in said if told in text]
    assert "mounted" not in third.context.facts
    assert third.context.facts["watchdog"].keys() == set("012345")


@pytest.mark.parametrize(("every", "found"), [(1000, False), (100, False), (16, True)])
def test_scan_of_a_50_Hz_bus_reports_lost_frames_by_their_share(every, found):
    rehearsal, polls = Rehearsal("vcan50"), count(1)
    sender = rehearsal.drives.protocol.sender

    def lossy(heard, _):
        lost = next(polls) % every == 30 % every
        return heard._replace(frames=tuple(f for f in heard.frames if not lost or sender(f.frame) != 2))

    rehearsal.hears(lossy)
    assert named(rehearsal.run(SCAN)) == ({("frames_lost", (2,))} if found else set())
