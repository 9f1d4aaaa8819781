"""What a bring-up writes and reads: state, found configuration, checklist, words, the terminal."""

import contextlib
import io
import json
import os
import re
import socket
import tempfile

import numpy as np
import pytest

from drivers.bus_address import BusAddress
from drivers.errors import ConfigurationError, RunError
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load, loads
from hil.lab.bringup import command
from hil.lab.bringup.checklist import checklist
from hil.lab.bringup.command import files_of, run_bringup
from hil.lab.bringup.context import Context, Finding, RefusedError, Request
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.found import commented, found_text, mended
from hil.lab.bringup.hands import RemoteHands, hands_socket, served_bench
from hil.lab.bringup.machine import build_machine
from hil.lab.bringup.procedure import Outcome
from hil.lab.bringup.rehearsal import mistake_of, wiring_of
from hil.lab.bringup.steps import encoder, ids, scan, silence
from hil.lab.bringup.store import Store, identity
from hil.lab.bringup.terminal import Terminal
from hil.record.log import Log
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal

FIRST = (scan.STEP, silence.STEP, ids.STEP, encoder.STEP)


def test_another_node_number_is_other_hardware_and_nothing_is_kept(tmp_path):
    c = load("virtual")
    path = tmp_path / "state.json"
    store = Store(path, identity(c, ()))
    store.facts["held"] = {"0": {"moved": False, "hand_N": 700.0}}
    store.save()
    assert Store(path, identity(c, ())).facts == {"held": {"0": {"moved": False, "hand_N": 700.0}}}
    other = loads(c.text.replace("node_ids: [1, 2,", "node_ids: [2, 1,"), "x", c.folder)
    assert other.drives.node_ids[:2] == [2, 1]
    again = Store(path, identity(other, ()))
    assert (again.facts, again.changed) == ({}, "node numbers")


def test_what_a_served_bench_has_shown_says_nothing_of_a_machine(tmp_path, short_folder, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", short_folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "_proceed", _stopped)
    c = loads(
        load("virtual").text.replace("folder: runs", f"folder: {tmp_path}/runs"), "x", load("virtual").folder
    )
    path, said = tmp_path / "state.json", list[str]()
    with served_bench(c, []):
        run_bringup("x", c, state=path, yes=True, say=said.append)
    run_bringup("x", c, state=path, say=said.append)
    assert f"other hardware than in {path} (rehearsal): everything is measured again" in said


def _stopped(c, protocol, end, store, *_, **__):
    """Keep a fact, and end."""
    context = Context(
        build_machine(c, protocol), Drives(protocol, end.line, 0.1), end.operator, store.facts, store.save
    )
    context.keep("held", 0, {"moved": False, "hand_N": 700.0})
    return Outcome((), (), stopped="ended"), context, "ended"


def test_what_is_to_be_mended_is_measured_again_and_the_rest_is_kept(tmp_path):
    store = Store(tmp_path / "s.json", {})
    for step in ("ids", "encoder", "opens", "mounted"):
        store.facts[step] = {str(leg): {} for leg in range(6)}
    store.forget([Finding("encoder_sign", (3,), "", "")])
    facts = json.loads((tmp_path / "s.json").read_text())["facts"]
    assert sorted(facts["encoder"]) == ["0", "1", "2", "4", "5"]
    assert "mounted" not in facts


def test_a_file_that_is_no_state_is_refused(tmp_path):
    path = tmp_path / "s.json"
    path.write_text("{}")
    with pytest.raises(RunError, match="no state of a bring-up"):
        Store(path, {})


def test_no_file_is_written_over(tmp_path):
    given = tmp_path / "my.yaml"
    given.write_text("")
    c = load("virtual")
    first = files_of(str(given), c, None, rehearsal=False)
    assert first.found == tmp_path / "my.bringup.yaml"
    first.checklist.write_text("x")
    assert files_of(str(given), c, None, rehearsal=False).found == tmp_path / "my.bringup-2.yaml"


def test_the_found_configuration_loads_with_comments_and_reduced_limits():
    rehearsal = Rehearsal("virtual", Wiring())
    outcome = rehearsal.run(FIRST)
    text = found_text(rehearsal.c, rehearsal.context, outcome.findings, released=True)
    found = loads(text, "found", rehearsal.c.folder)
    assert found.limits.speed_m_s == 0.5
    assert found.limits.following_error_m == 0.0025
    assert "# proven by silence: 12 ms at the latest" in text
    assert "NOT RELEASED" not in text
    assert found.platform == rehearsal.c.platform


def test_a_wrong_lead_a_reversed_drive_and_a_zero_are_found_for_motors():
    """The encoder then reads what the tape does: q = offset + sign lead n."""
    wiring = wired(
        Mistake("wrong_lead", 1, value=1.25),
        Mistake("drive_reversed", 2),
        Mistake("offset", 4, value=5e-3),
        Mistake("offset", 5, value=-5e-3),
    )
    rehearsal = Rehearsal("desktop", wiring)
    outcome = rehearsal.run(FIRST)
    assert {f.name for f in outcome.findings} == {"encoder_scale", "encoder_sign", "offset"}
    more, less = [f for f in outcome.findings if f.name == "offset"]
    assert re.fullmatch(r"it reads [45]\.\d\d mm more than the tape", more.text)
    assert re.search(r"take [45]\.\d\d mm off its zero", more.mend)
    assert re.fullmatch(r"it reads [45]\.\d\d mm less than the tape", less.text)
    assert re.search(r"add [45]\.\d\d mm to its zero", less.mend)
    findings = [
        Finding("wrong_lead", (1,), "", ""),
        Finding("drive_reversed", (2,), "", ""),
        *[f for f in outcome.findings if f.name == "offset"],
    ]
    found = loads(found_text(rehearsal.c, rehearsal.context, findings), "found", rehearsal.c.folder)
    gear, was = found.drives.transmission, rehearsal.c.drives.transmission
    assert gear is not None
    assert was is not None
    assert gear.sign == [1, -1, -1, -1, 1, -1]
    assert gear.pulley_radius_m == pytest.approx([0.02, 0.016, 0.02, 0.02, 0.02, 0.02], rel=5e-3)
    # the bench's encoders are right at the middle of the stroke, 0.325 m, where the offset is; but legs 4, 5
    assert was.offset_m == 0.325
    assert np.array(gear.offset_m) - 0.325 == pytest.approx([0, 0, 0, 0, -5e-3, 5e-3], abs=1e-3)


def test_behind_exchanged_numbers_the_file_mends_the_numbers_alone():
    """Drives 1 and 4 were read with each other's sign: exchanged, they are right."""
    rehearsal = Rehearsal("desktop", Wiring())
    c = rehearsal.c
    facts = {
        str(leg): {"drive": drive, "tape_m": [0.25, 0.4], "scale": -1.0, "offset_m": 0.0, "bent_m": 0.0}
        for leg, drive in ((1, 4), (4, 1))
    }
    rehearsal.context.facts["encoder"] = facts
    findings = [
        Finding("ids", (1, 4), "exchanged", ""),
        Finding("drive_reversed", (1,), "", ""),
        Finding("offset", (4,), "", ""),
        Finding("wrong_lead", (4,), "", ""),
    ]
    assert mended(c, rehearsal.context, findings) == findings[:1]
    assert mended(c, rehearsal.context, findings[1:]) == findings[1:]
    found = loads(found_text(c, rehearsal.context, findings), "found", c.folder)
    n = list(c.drives.node_ids)
    assert list(found.drives.node_ids) == [n[0], n[4], n[2], n[3], n[1], n[5]]
    assert found.drives.transmission == c.drives.transmission


def test_behind_crossed_encoder_cables_the_file_changes_no_transmission_and_no_number_but_the_exchanged():
    """Drives 0 and 2 have each other's encoder, drives 1 and 4 each other's number."""
    rehearsal = Rehearsal("desktop", Wiring())
    c = rehearsal.c
    reads = {0: 2, 2: 0, 1: 4, 4: 1}
    rehearsal.context.facts["encoder"] = {
        str(leg): {"drive": drive, "tape_m": [0.25, 0.4], "scale": -1.0, "offset_m": 2e-3, "bent_m": 0.0}
        for drive, leg in reads.items()
    }
    crossed = Finding("encoder_crossed", (0, 2), "crossed", "")
    others = [Finding("offset", (0,), "", ""), Finding("drive_reversed", (2,), "", "")]
    exchanged = Finding("ids", (1, 4), "exchanged", "")
    for findings, done in (([crossed, *others], []), ([exchanged, crossed, *others], [exchanged])):
        assert mended(c, rehearsal.context, findings) == done
        found = loads(found_text(c, rehearsal.context, findings), "found", c.folder)
        n = list(c.drives.node_ids)
        assert list(found.drives.node_ids) == ([n[0], n[4], n[2], n[3], n[1], n[5]] if done else n)
        assert found.drives.transmission == c.drives.transmission


def test_numbers_that_are_not_exchanged_among_themselves_are_not_written():
    rehearsal = Rehearsal("desktop", Wiring())
    c = rehearsal.c
    known = {"tape_m": [0.25, 0.4], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0}
    rehearsal.context.facts["encoder"] = {"1": {"drive": 0, **known}, "2": {"drive": 1, **known}}
    findings = [Finding("ids", (0,), "exchanged", "")]
    assert mended(c, rehearsal.context, findings) == []
    found = loads(found_text(c, rehearsal.context, findings), "found", c.folder)
    assert list(found.drives.node_ids) == list(c.drives.node_ids)


def test_limits_are_reduced_once_however_often_the_written_file_is_given_again():
    rehearsal = Rehearsal("virtual", Wiring())
    c = rehearsal.c
    once = loads(found_text(c, rehearsal.context, []), "once", c.folder)
    assert once.limits.speed_m_s == 0.25 * c.limits.speed_m_s
    text = found_text(once, rehearsal.context, [])
    twice = loads(text, "twice", c.folder)
    assert (twice.limits, twice.engage) == (once.limits, once.engage)
    assert "was configured" not in text


def test_comments_stand_above_their_keys():
    text = commented("a:\n  x: 1\nb:\n  x: 2\n", {("b", "x"): ["measured"]})
    assert text == "a:\n  x: 1\nb:\n  # measured\n  x: 2\n"


def test_the_checklist_marks_what_passed_and_what_was_found():
    rehearsal = Rehearsal("virtual", wired(Mistake("encoder_sign", 3)))
    outcome = rehearsal.run(FIRST)
    lines = checklist(rehearsal.context, outcome, ["[ ] together"])
    assert "[x] scan: who answers on the bus" in lines
    assert "[!] encoder: encoders and strokes, by tape" in lines
    assert "[ ] force: forces and friction, one leg at a time" in lines
    assert any(line.startswith("    ! encoder_sign: leg 3: ") for line in lines)
    assert sum("leg" in line and "reads -" in line for line in lines) == 1


def test_words_of_mistakes():
    protocol = build_protocol(load("virtual"))
    assert mistake_of("encoder_scale leg=2 value=1.01") == Mistake("encoder_scale", 2, value=1.01)
    assert wiring_of(["ids_swapped leg=1 other=4"], protocol).motor == (0, 4, 2, 3, 1, 5)
    for words in (
        "nonsense leg=1",
        "offset leg=x",
        "offset of=1",
        "ids_swapped leg=1 other=1",
        "offset leg=6",
    ):
        with pytest.raises(ConfigurationError, match="--mistake"):
            wiring_of([words], protocol)


def test_the_terminal_takes_numbers_asks_again_and_ends():
    reading, writing = os.pipe()
    said: list[str] = []
    with os.fdopen(reading) as source:
        terminal = Terminal(said.append, source)
        terminal.ask(Request("measure", 1, 0.0, "Measure leg 1"))
        assert terminal.answer() is None
        os.write(writing, b"1.2x\n")
        assert terminal.answer() is None
        assert "is no number" in said[-1]
        os.write(writing, b"1.25\n")
        assert terminal.answer() == 1.25
        terminal.ask(Request("push", 1, 0.0, "Push"))
        os.write(writing, b"no\n")
        with pytest.raises(RefusedError):
            terminal.answer()
        os.close(writing)


def test_a_closed_terminal_is_no_consent():
    with pytest.raises(RefusedError):
        Terminal(lambda _: None, io.StringIO("")).consent("step", "does", "Ctrl-C")


@pytest.fixture
def short_folder():
    """The path of a socket has 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        yield folder


def test_the_hands_of_a_served_bench_are_asked_by_a_socket(short_folder, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", short_folder)
    c = load("virtual")
    beside = Terminal(lambda _: None, io.StringIO(""))
    address = BusAddress(c.bus.interface, c.bus.channel)
    with pytest.raises(RunError, match="nobody serves a bench"):
        RemoteHands(address, beside, lambda *_: True)
    with served_bench(c, ["end_stop leg=2 value=0.5"]) as bench:
        with contextlib.closing(RemoteHands(address, beside, lambda *_: True)) as hands:
            lengths = []
            with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as stranger:
                for nonsense in (
                    *(b"nonsense", b"[1]", b'["measure", 9, 0]', b'["measure", {}, 0]'),
                    *(b'["fly", 1, 0]', b'["move", 1, NaN]', b'["move", -2, 0.1]'),
                ):
                    stranger.sendto(nonsense, str(hands_socket(address.interface, address.channel)))
                    bench.hands()
            for request in (Request("place", 2, 1.0), Request("measure", 2)):
                hands.ask(request)
                assert hands.answer() is None
                bench.hands()
                lengths.append(hands.answer())
        with pytest.raises(RunError, match="another bench"), served_bench(c, []):
            pass
        hands = RemoteHands(address, beside, lambda *_: True)
    with contextlib.closing(hands), pytest.raises(RunError, match="the bench has ended"):
        hands.answer()
    # stroke 0.75 to 2.2 m, and 2 % beyond it, less half of it
    assert lengths == [0.0, pytest.approx(2.2 + 0.02 * 1.45 - 0.5 * 1.45, abs=1e-3)]


@pytest.mark.long
@pytest.mark.parametrize("name", ["virtual", "desktop", "lab", "socketcan"])
def test_a_rehearsal_ends_with_six_legs_that_move_and_files_that_load(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    summary = run_bringup(name, load(name), mistakes=[], yes=True, say=said.append)
    assert summary["success"]
    found = load(summary["found"])
    assert found.drives.node_ids == load(name).drives.node_ids
    checked = (tmp_path / summary["checklist"]).read_text()
    assert checked.count("[x]") == 9
    events = [text for _, _, text in Log(summary["log"]).events()]
    assert "[x] gauge: force scales, by force gauge" in events
    again = run_bringup(name, load(name), mistakes=[], yes=True, say=said.append)
    assert again["success"]
    assert said.count("  passed before") == 7


@pytest.mark.long
def test_after_a_finding_the_mended_leg_alone_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    c = load("virtual")
    state = tmp_path / "s.json"
    bad = Rehearsal("virtual", wired(Mistake("encoder_sign", 3)))
    store = Store(state, identity(c, ()))
    bad.context.facts, bad.context.save = store.facts, store.save
    store.forget(bad.run().findings)
    good = Rehearsal("virtual", Wiring(), facts=Store(state, identity(c, ())).facts)
    assert good.run().success
    assert {r.leg for r in good.hands.requests if r.leg >= 0} == {3}


@pytest.mark.parametrize("name", ["absent", "same_id", "wrong_protocol", "second_controller", "set_up"])
def test_a_platform_that_hangs_is_known_after_a_finding_for_which_the_bus_is_scanned_again(tmp_path, name):
    path = tmp_path / "s.json"
    store = Store(path, {})
    facts = store.facts
    facts |= {"platform": {"hung": True}, "passed": {"mounted": True}}
    store.forget([Finding(name, (2,), "", "")])
    assert Store(path, {}).facts == facts == {"platform": {"hung": True}}


def test_after_an_absent_drive_no_brake_opens_before_the_hung_platform_is_off(tmp_path):
    store = Store(tmp_path / "s.json", {})
    store.facts["platform"] = {"hung": True}
    store.forget([Finding("absent", (2,), "", "")])
    rehearsal = Rehearsal("virtual", Wiring(), facts=Store(tmp_path / "s.json", {}).facts)
    rehearsal.bench.hung = True
    rehearsal.run((scan.STEP, silence.STEP))
    with rehearsal.context.opened(3):
        assert not rehearsal.bench.hung
    assert [request.act for request in rehearsal.hands.requests] == ["take_down"]
    assert rehearsal.watched.most_open == 1
    assert rehearsal.watched.opened_while_hung == 0


def test_an_encoder_that_was_mended_behind_exchanged_numbers_is_measured_again(tmp_path):
    """The finding names the drive, 4; the facts are those of leg 1, which it counts."""
    bad = Rehearsal("virtual", wired(Mistake("ids_swapped", 1, 4), Mistake("encoder_jumps", 1)))
    store = Store(tmp_path / "s.json", {})
    bad.context.facts = store.facts
    outcome = bad.run(FIRST)
    assert [finding.name for finding in outcome.findings] == ["encoder_jumps"]
    store.forget(outcome.findings)
    mended = Rehearsal("virtual", wired(Mistake("ids_swapped", 1, 4)), facts=store.facts)
    assert mended.run(FIRST).findings == ()
    measured = [request.leg for request in mended.hands.requests if request.act == "measure"]
    assert sorted(measured) == [1, 1, 1, 4, 4, 4]
