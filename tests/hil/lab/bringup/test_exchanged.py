"""A drive that was exchanged between two sessions: the scan asks who each drive is, and compares."""

from __future__ import annotations

import copy

import pytest

from drivers.cia402 import objects
from drivers.mit.protocol import MitProtocol
from drivers.mit.robstride import RobStrideProtocol
from drivers.odrive import ODriveProtocol
from drivers.protocol import EXTENDED, REMOTE, Frame, Said
from hil.app.compose import build_protocol
from hil.contracts.messages import Rejected, hear
from hil.lab.bringup.checklist import checklist
from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.store import refuse_malformed
from plant_fmu.drives import drives_end
from plant_fmu.drives.cia402_dictionary import PLACE, defaults
from plant_fmu.rehearsal.wiring import Wiring
from tests.broad import broad
from tests.drivers.motor_families import Motors
from tests.hil.lab.bringup.families import FAMILIES, family
from tests.hil.lab.bringup.kit import Rehearsal

BY_HAND = STEPS[:4]
"""Scan, watchdog, ids, encoder."""


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
def test_a_drive_that_was_exchanged_between_two_sessions_is_measured_again_and_no_other(
    monkeypatch, key, told
):
    first = Rehearsal("cia402_pdo", Wiring())
    assert first.run(BY_HAND).success
    facts = first.context.facts
    refuse_malformed(facts)
    assert facts["identity"]["2"] == {"serial number": 3, "revision": 1}
    assert "serial number 3, revision 1" in "\n".join(checklist(first.context, first.run(BY_HAND), ()))

    again = Rehearsal("cia402_pdo", Wiring(), facts=copy.deepcopy(facts))
    said: list[str] = []
    monkeypatch.setattr(again.hands, "tell", said.append)
    assert again.run(BY_HAND).success
    assert asked_legs(again) == set()
    assert not any("another drive" in text for text in said)

    with_another(monkeypatch, 3, key, 77)
    third = Rehearsal("cia402_pdo", Wiring(), facts=copy.deepcopy(facts) | {"mounted": {"0": {}}})
    monkeypatch.setattr(third.hands, "tell", said.append)
    assert third.run(BY_HAND).success
    assert asked_legs(third) == {2}
    who = "another drive answers" if key == objects.SERIAL else "the same drive has changed"
    assert [text for text in said if who in text and told in text]
    assert "mounted" not in third.context.facts
    assert third.context.facts["watchdog"].keys() == set("012345")


def requests_of(name):
    protocol = build_protocol(family(name))
    return protocol.traits.identity_requests


def test_each_family_that_can_be_asked_says_who_its_drives_are_and_the_others_are_not_asked():
    told = {}
    for name in ("cia402_pdo", "robstride", "odrive", "damiao", "moteus_stopped", "cubemars", "legs_fd"):
        rehearsal = Rehearsal(name, Wiring())
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


def test_a_damiao_is_asked_by_its_registers_15_and_14():
    """tests/data/drives/damiao.json: reading on 0x7FF, answered on the drive's own; 13 to 16 are uint32."""
    damiao = build_protocol(family("damiao"))
    assert isinstance(damiao, MitProtocol)
    serial, version = damiao.traits.identity_requests
    assert serial[4] == Frame(0x7FF, bytes.fromhex("0500330f00000000"))
    assert version[0] == Frame(0x7FF, bytes.fromhex("0100330e00000000"))
    answer = Frame(damiao.replies[4], bytes.fromhex("0500330f785634f2"))
    assert damiao.identity(answer) == Said(4, "serial number", 0xF2345678)
    heard = Motors(damiao).hear(answer)
    assert heard is not None
    assert heard.answer is None, "no answer to the set-up"
    for other in ("0500550f785634f2", "0600330f785634f2", "0500330a785634f2", "0500330f7856"):
        assert damiao.identity(answer._replace(data=bytes.fromhex(other))) is None
    refused = hear(drives_end(damiao), Frame(0x7FF, bytes.fromhex("0500550f00000000")))
    assert isinstance(refused[0], Rejected)
