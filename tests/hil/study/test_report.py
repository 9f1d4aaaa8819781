"""`hil report`: the story of a fault; logs that are truncated, damaged or hostile."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.signals import Fault, Mode
from drivers.tick_columns import RECORDED
from hil.app.configuration.configuration import load
from hil.app.configuration.fault_words import with_faults
from hil.app.sim.command import simulate
from hil.record import Recording
from hil.record.log import Event, Log
from hil.record.schema import IDENTITY, SUMMARY
from hil.study.report import run, sections
from hil.study.report.command import report
from hil.study.report.page import as_script, prose, tag
from hil.study.report.story import failure_of
from tests.broad import broad
from tests.hil.samples import random_ticks, record
from tests.hil.study.test_report_limits import RATE_Hz, rows_of

HOSTILE = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    simulate(load("virtual"), log=folder / "good.mcap", duration_s=1.0, check_replay=False)
    faulted = with_faults(load("virtual"), ("encoder_jump leg=3 at=2 by=5e-3",))
    simulate(faulted, log=folder / "bad.mcap", duration_s=3.0, check_replay=False)
    return folder


# -- the story -----------------------------------------------------------------------------------------------


def test_report_begins_with_leg_value_limit_time_reaction_and_advice_of_the_fault(logs, tmp_path):
    out = tmp_path / "bad.html"
    summary = report(logs / "bad.mcap", out=out)
    assert summary["went_wrong"] == "latched fault ENCODER"
    text = out.read_text()
    opening = text[text.index("<main") : text.index("<h2>Smallest margin")]
    for said in (
        "ENCODER",
        ">2.000<",
        "TRACKING",
        ">3<",
        "5 mm",
        "its encoder jumped",
        "hil run CONFIG --release",
    ):
        assert said in opening, said
    assert "check encoder, coupling, zero and brake" in opening
    assert "docs/guides/glossary-of-faults.md#fault-encoder" in opening
    assert "the brakes were commanded to close" in opening
    assert "RUN" in opening


def test_faults_in_the_report_come_from_the_ticks_if_the_log_summary_lacks_a_fault_report():
    rows = rows_of(100)
    rows["mode"][40:], rows["faults"][40:] = Mode.FAULT, Fault.SPEED
    rows["faults"][70:] = Fault.SPEED | Fault.STALE
    found = failure_of({}, rows, RATE_Hz)
    faults = [(each.fault, each.time_s, each.mode) for each in found.findings]
    assert faults == [("SPEED", 0.04, "TRACKING"), ("STALE", 0.07, "FAULT")]
    assert found.headline == "latched fault SPEED, STALE"
    assert found.lines["next"][0].endswith("#fault-speed")


HUGE = int("7" * 400)


@pytest.mark.parametrize("story", ["", "{", "[]", "7", '{"findings": 3}', '{"findings": [null]}', "[" * 9999])
def test_report_ignores_a_fault_report_of_unknown_form_in_the_log_summary(story):
    found = failure_of({SUMMARY: {"story": story}}, rows_of(5), RATE_Hz)
    assert "<" in sections.what_went_wrong(found)


@pytest.mark.parametrize(
    "number", [HUGE, 1.7e308, 1e-320, 2**63, -1, True, "7" * 400, None, [HUGE], {"a": HUGE}]
)
@pytest.mark.parametrize("name", ["time_s", "value", "limit", "leg", "mode", "fault", "text", "unit"])
def test_report_handles_any_number_in_a_fault_finding(name, number):
    """A number that no field can hold invalidates the story; then the rows count, here without fault."""
    finding = {"fault": "STALE", "time_s": 0.003, "unit": "m"} | {name: number}
    story = json.dumps({"findings": [finding], "lines": ["done: stopped"]})
    found = failure_of({SUMMARY: {"story": story}}, rows_of(9), RATE_Hz)
    assert [each.fault for each in found.findings] in ([], ["STALE"], [number])
    assert "<" in sections.what_went_wrong(found)


def test_texts_of_a_log_are_escaped_everywhere_in_the_report():
    finding = dict.fromkeys(("fault", "mode", "value", "limit", "unit", "limit_key", "text"), HOSTILE)
    lines = [f"{key}: {HOSTILE}" for key in ("next", "done", "drives", "in the end")]
    story = json.dumps({"findings": [finding], "lines": lines})
    found = failure_of({SUMMARY: {"story": story, "reason": HOSTILE}}, rows_of(5), RATE_Hz)
    parts = [
        sections.opening(found, rows_of(5), HOSTILE),
        sections.what_went_wrong(found),
        sections.modes(rows_of(5), np.arange(5.0), [Event(0, HOSTILE, HOSTILE)])[-1],
        sections.limits([], np.arange(5.0), HOSTILE),
        sections.figures([(HOSTILE, HOSTILE)]),
        tag("p", HOSTILE, title=HOSTILE),
    ]
    assert all("&lt;/script&gt;" in part for part in parts)
    assert not any("<script" in part for part in parts)
    assert parts[1].count("&lt;/script&gt;") == 2 * (6 + 4), (
        "all but the unit, which stands with numbers alone"
    )
    assert "<" not in as_script({HOSTILE: [HOSTILE]})
    assert json.loads(as_script({HOSTILE: [HOSTILE]})) == {HOSTILE: [HOSTILE]}


@pytest.mark.parametrize(
    ("remark", "verdict"), [("", "Parked without a fault"), ("the log is damaged", "ends in PARKED")]
)
def test_an_incomplete_log_is_never_reported_as_free_of_faults(remark, verdict):
    rows = rows_of(5, mode=Mode.PARKED)
    made = sections.opening(failure_of({}, rows, RATE_Hz), rows, remark)
    assert verdict in made
    assert ("This page shows the readable part" in made) is bool(remark)


# -- logs that are cut or strange ----------------------------------------------------------------------------


def test_a_truncated_log_is_shown_to_its_end_with_a_remark(logs, tmp_path):
    whole = (logs / "good.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    summary = report(cut)
    assert summary["remark"] == f"the log is cut at {cut.stat().st_size} bytes, the end is missing"
    text = cut.with_suffix(".html").read_text()
    assert "This page shows the readable part" in text
    assert "Parked without a fault" not in text
    assert sorted(tmp_path.iterdir()) == [cut.with_suffix(".html"), cut], "nothing else is left behind"


def test_a_damaged_log_is_refused_with_the_command_that_salvages_it(logs, tmp_path):
    content = bytearray((logs / "good.mcap").read_bytes())
    content[content.rindex(b"\x28\xb5\x2f\xfd", 0, len(content) // 2) + 1000] ^= 0x10  # zstd's magic number
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content)
    with pytest.raises(LogError, match=r"bad\.mcap: damaged at byte \d+: .*--salvage"):
        report(bad)


@pytest.mark.parametrize("said", ["0", "-1", "nan", "inf", "100001", "fast", "9" * 400])
def test_report_of_a_log_with_an_impossible_loop_rate_is_refused(tmp_path, said):
    path = tmp_path / "a.mcap"
    options = {"kind": "sim", "rate_Hz": said}
    with Recording.start(path, configuration="", lockstep=True, metadata=options) as recording:
        record(recording, random_ticks(5, seed=1))
    with pytest.raises(LogError, match=r"rate_Hz: .*at most 100000$") as caught:
        report(path)
    assert len(str(caught.value)) < 200 + len(str(path))


@pytest.mark.parametrize(
    ("options", "columns", "said"),
    [
        ({"kind": "plant"}, RECORDED, "of kind 'plant', allowed: one of `hil run` or `hil sim`"),
        ({"kind": "sim", "rate_Hz": RATE_Hz}, RECORDED[1:], r"its columns differ \(.*, which made it"),
    ],
)
def test_a_log_of_another_kind_or_version_is_refused_with_advice(
    tmp_path, monkeypatch, options, columns, said
):
    log = SimpleNamespace(path="a.mcap", columns=columns, metadata={IDENTITY: options})
    monkeypatch.setattr(run, "readable", lambda _: (log, [], ""))
    with pytest.raises(LogError, match=f"{said}.*; `hil plot` draws its columns$"):
        report(tmp_path / "a.mcap")


EXTREMES = {"i": (-(2**63), -1, 2**40, 2**63 - 1), "f": (np.nan, np.inf, -np.inf, 1e308, -1e-310)}


@pytest.mark.parametrize("seed", broad(range(6), quick=3))
def test_a_log_with_any_numbers_gives_a_page(logs, tmp_path, monkeypatch, seed):
    rng = np.random.default_rng(seed)

    def rows(log):
        found = Log.__dict__["_rows"](log)
        for name in rng.permutation(found.dtype.names)[: 10 + 10 * seed]:
            column = found[name]
            at = rng.random(column.shape) < rng.choice([0.001, 0.3, 1.0])
            column[at] = rng.choice(np.array(EXTREMES[column.dtype.kind], column.dtype), int(at.sum()))
        return found

    monkeypatch.setattr(Log, "_rows", Log.rows, raising=False)
    monkeypatch.setattr(Log, "rows", rows)
    out = tmp_path / "any.html"
    report(logs / "bad.mcap", out=out)
    data = out.read_text().partition('id="data">')[2].partition("</script>")[0]
    assert {"Leg error [mm]", "Leg force [N]", "mode"} & {
        chart["key"] for chart in json.loads(data)["charts"]
    }


@pytest.mark.parametrize("count", [1, 2, 33])
def test_a_log_with_few_ticks_of_any_content_gives_a_page(tmp_path, count):
    path = tmp_path / "a.mcap"
    options = {"kind": "sim", "rate_Hz": RATE_Hz}
    with Recording.start(
        path, configuration=load("virtual").text, lockstep=True, metadata=options
    ) as recording:
        record(recording, random_ticks(count, seed=count))
    last = int(random_ticks(count, seed=count)[-1].row["mode"])
    assert last not in set(Mode), "a mode without a name"
    assert Log(path).figures()["final_mode"] == str(last)
    report(path)
    assert str(last) in path.with_suffix(".html").read_text(encoding="utf-8")


def test_a_log_without_configuration_still_shows_its_faults(logs, tmp_path, monkeypatch):
    monkeypatch.setattr(Log, "configuration", "nonsense: 1\n")
    summary = report(logs / "bad.mcap", out=tmp_path / "bare.html")
    text = (tmp_path / "bare.html").read_text()
    assert "its encoder jumped" in text
    for place in (summary["remark"], text):
        assert "no limits, bus load and 3D view" in place
    assert 'id="scene"' not in text


def test_text_between_backticks_becomes_code_and_a_lone_backtick_stays():
    assert prose("say `hil check`, then `<b>`") == "say <code>hil check</code>, then <code>&lt;b&gt;</code>"
    assert prose("a ` b") == "a ` b"
