"""What `hil report` finds in a log: margins, peaks, the story of a fault; and logs that are cut or strange."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import LogError
from drivers.signals import Fault, Mode, Warn
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.app.configuration.fault_words import with_faults
from hil.app.sim.command import simulate
from hil.cli import main
from hil.record import Recording
from hil.record.log import Event, Log
from hil.study.report import sections
from hil.study.report.charts import Chart, Curve
from hil.study.report.command import report
from hil.study.report.html import prose, tag
from hil.study.report.margins import margins
from hil.study.report.page import as_script, drawn
from hil.study.report.samples import thin
from hil.study.report.story import told
from hil.study.report.timeline import lanes, spells
from tests.broad import broad
from tests.hil.samples import random_ticks, record

RATE_Hz = 1000.0
HOSTILE = "</script><script>alert(1)</script>"


def rows_of(n, **columns):
    """Rows of a platform that tracks and rests in mid-stroke, with other columns."""
    c = load("virtual").platform
    rows = np.zeros(n, ROW)
    rows["tick"] = np.arange(n)
    rows["t_ns"] = 1_000_000 * np.arange(n)
    rows["mode"] = Mode.TRACKING
    rows["q"] = rows["q_d"] = (c.length_min_m + c.length_max_m) / 2
    for name, value in columns.items():
        rows[name] = value
    return rows


def margin(rows, key, name=""):
    (found,) = (m for m in margins(rows, load("virtual"), RATE_Hz) if m.key == key and name in m.name)
    return found


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    simulate(load("virtual"), log=folder / "good.mcap", duration_s=1.0, check_replay=False)
    faulted = with_faults(load("virtual"), ("encoder_jump leg=3 at=2 by=5e-3",))
    simulate(faulted, log=folder / "bad.mcap", duration_s=3.0, check_replay=False)
    return folder


# -- margins -------------------------------------------------------------------------------------------------


def test_a_margin_names_leg_instant_value_and_limit():
    rows = rows_of(100)
    rows["dq"][40, 2] = -1.5
    limit = load("virtual").limits.speed_m_s
    found = margin(rows, "limits.speed_m_s")
    assert (found.leg, found.row, found.value, found.limit, found.unit) == (2, 40, 1.5, limit, "m/s")
    assert found.used_percent == pytest.approx(150.0 / limit)


def test_what_happens_while_a_rule_is_not_judged_is_no_margin():
    rows = rows_of(100)
    rows["dq"][70:, 0], rows["dq"][10, 1] = 1.9, 0.5
    rows["mode"][70:] = Mode.FAULT
    rows["faults"][70:] = Fault.DRIVE
    assert margin(rows, "limits.speed_m_s").row == 70, "the tick of the fault still counts"
    rows["dq"][70, 0] = 0.0
    found = margin(rows, "limits.speed_m_s")
    assert (found.row, found.leg) == (10, 1)


def test_a_leg_error_is_measured_against_what_its_own_speed_allows():
    limits = load("virtual").limits
    rows = rows_of(10)
    rows["q_d"][3, 0] += 0.9 * limits.following_error_m
    rows["q_d"][7, 5] += 1.1 * limits.following_error_m
    rows["dq_d"][7, 5] = -limits.following_error_m / limits.following_error_s
    found = margin(rows, "limits.following_error_m")
    assert (found.row, found.leg) == (3, 0), "110 % at rest are 55 % at the speed that doubles the limit"
    assert found.used_percent == pytest.approx(90.0)


def test_the_change_of_force_within_the_window_is_that_of_all_pairs_of_ticks():
    rng = np.random.default_rng(5)
    tau = np.cumsum(rng.normal(0.0, 10.0, (900, 6)), axis=0)
    found = margin(rows_of(900, tau=tau), "limits.force_window_N")
    pairs = [
        (abs(tau[k, leg] - tau[j, leg]), k, leg)
        for leg in range(6)
        for k in range(900)
        for j in range(max(0, k - 250), k)
    ]
    value, row, leg = max(pairs)
    assert (found.value, found.row, found.leg) == (pytest.approx(value), row, leg)


def test_motion_on_closed_brakes_counts_from_where_a_leg_was_first_heard():
    rows = rows_of(60)
    rows["mode"][:30], rows["mode"][50:] = Mode.LOADING, Mode.UNLOADING
    rows["age"][:5] = 3
    rows["q"][:5] = 0.0
    rows["q"][20, 4] += 2e-4
    rows["q"][30:] += 0.1
    rows["q"][55, 1] -= 3e-4
    found = margin(rows, "limits.standstill_m")
    assert (found.row, found.leg, found.value) == (55, 1, pytest.approx(3e-4))


def test_braking_is_judged_towards_the_end_that_a_leg_moves_to():
    c = load("virtual")
    soft = c.platform.length_max_m - c.limits.stroke_margin_m
    rows = rows_of(10)
    rows["q"][:, 0], rows["q_d"][:, 0] = soft - 0.02, soft - 0.02
    rows["dq"][2, 0], rows["dq"][6, 0] = 0.4, -0.9
    found = margin(rows, "limits.deceleration_m_s2")
    assert (found.row, found.leg) == (2, 0)
    assert found.limit == pytest.approx((2 * c.limits.deceleration_m_s2 * 0.02) ** 0.5)


def test_missed_periods_add_up_until_a_tick_is_on_time():
    rows = rows_of(20)
    rows["skipped"][[5, 6, 9]] = (1, 2, 2)
    assert margin(rows, "limits.missed_stop_ticks").value == 3


def test_of_32_ticks_those_with_refused_frames_are_counted():
    rows = rows_of(200)
    rows["rejected"][[10, 20, 41, 42, 43, 120]] = 4
    found = margin(rows, "", "frames were refused")
    assert (found.value, found.row) == (4, 43), "10 is 33 ticks before 43; 20 to 43 are four"


def test_the_tick_in_which_a_brake_gave_way_counts():
    rows = rows_of(60)
    rows["mode"][:] = Mode.LOADING
    rows["q"][40:, 2] += 6e-4
    rows["mode"][40:], rows["faults"][40:] = Mode.FAULT, Fault.BRAKE
    rows["q"][41:, 2] += 1.0
    found = margin(rows, "limits.standstill_m")
    assert (found.row, found.leg, found.value) == (40, 2, pytest.approx(6e-4))


def test_a_force_step_is_one_between_ticks_that_follow_each_other():
    rows = rows_of(400)
    rows["tau"][:, 1] = 100.0
    rows["tau"][200:, 1] = 1000.0
    rows["tau"][300:, 4] = 50.0
    rows["tick"][200:] += 40
    rows["t_ns"] = 1_000_000 * rows["tick"]
    found = margin(rows, "limits.force_step_N")
    assert (found.row, found.leg, found.value) == (300, 4, 50.0), "40 lost ticks are no step"
    rows["skipped"][200] = 40
    found = margin(rows, "limits.force_step_N")
    assert (found.row, found.leg, found.value) == (200, 1, 900.0), "a skipped tick holds the force"


def test_the_first_force_of_a_run_is_a_step_from_none():
    rows = rows_of(20)
    rows["mode"][:10] = Mode.IDLE
    rows["tau"][10:, 5] = -300.0
    found = margin(rows, "limits.force_step_N")
    assert (found.row, found.leg, found.value) == (10, 5, 300.0)


def test_the_window_of_forces_is_one_of_time_where_ticks_are_missing():
    rows = rows_of(300)
    rows["tau"][:100, 3] = 700.0
    rows["tick"][110:] += 500
    rows["tau"][115:, 3] = 30.0
    rows["tau"][115:, 0] = 90.0
    found = margin(rows, "limits.force_window_N")
    assert (found.row, found.leg, found.value) == (100, 3, 700.0)
    rows["tau"][100:110, 3] = 700.0 - 7.0 * np.arange(10)
    rows["tau"][110:, 3] = 600.0
    rows["tau"][111:, 3] = 575.0
    assert margin(rows, "limits.force_window_N").value == 90.0, "500 lost ticks are longer than 250 ms"


def test_the_certificate_is_used_up_by_what_lasts_and_not_by_one_tick():
    confirm = load("virtual").monitor.confirm_ticks
    rows = rows_of(60)
    rows["lyapunov_share"] = 0.1
    rows["lyapunov_share"][:3] = np.nan
    rows["lyapunov_share"][[10, 11, 30, 31, 32]] = [5.0, 5.0, 0.8, 0.7, 0.9]
    assert confirm == 3
    found = margin(rows, "monitor")
    assert (found.value, found.row) == (0.7, 32)
    rows["lyapunov_share"] = np.nan
    assert not [m for m in margins(rows, load("virtual"), RATE_Hz) if m.key == "monitor"]


def test_the_page_of_a_log_whose_clock_is_at_its_end_is_written(logs, tmp_path, monkeypatch):
    plain = Log.rows

    def rows(log):
        found = plain(log)
        found["t_ns"][0] = 2**63 - 1
        return found

    monkeypatch.setattr(Log, "rows", rows)
    report(logs / "bad.mcap", out=tmp_path / "late.html")
    assert "1000 Hz, simulated time" in (tmp_path / "late.html").read_text()


def test_the_margin_of_an_encoder_names_its_leg_and_counts_at_rest_too():
    rows = rows_of(40)
    rows["encoder_share"] = np.nan
    assert not [m for m in margins(rows, load("virtual"), RATE_Hz) if m.key == "monitor.length_noise_m"]
    rows["encoder_share"][:] = 0.25
    rows["encoder_share"][[5, 9], [2, 4]] = 0.5, 0.75
    rows["mode"][:8] = Mode.IDLE
    rows["mode"][9] = Mode.WAITING
    found = margin(rows, "monitor.length_noise_m")
    assert (found.row, found.leg, found.value, found.limit) == (5, 2, 0.5, 1.0)


# -- a fused pose --------------------------------------------------------------------------------------------


def fused(**settings):
    c = load("virtual")
    fusion = c.estimation.fusion.model_copy(update={"may_lose_legs": [1, 4]} | settings)
    return c.model_copy(
        update={"estimation": c.estimation.model_copy(update={"pose": "fused", "fusion": fusion})}
    )


def fused_margin(rows, name, c=None, rate_Hz=RATE_Hz):
    (found,) = (m for m in margins(rows, c or fused(), rate_Hz) if name in m.name)
    return found


def test_without_a_fused_pose_there_is_no_row_of_it():
    assert not [m for m in margins(rows_of(9), load("virtual"), RATE_Hz) if "fus" in m.key]


def test_the_uncertainty_of_a_fused_position_is_that_of_all_three_directions():
    rows = rows_of(30)
    rows["pose_std"][12] = [2e-3, 1e-3, 2e-3, 9.0, 9.0, 9.0]
    found = fused_margin(rows, "standard deviation", fused(position_std_max_m=6e-3))
    assert (found.row, found.value, found.used_percent) == (12, pytest.approx(3e-3), pytest.approx(50.0))


def test_a_lost_encoder_counts_the_time_without_the_tracker():
    rows = rows_of(100)
    rows["tracker"][[20, 60]] = 1
    rows["tracker"][30] = -1
    rows["legs_lost"][40:90] = 1 << 4
    found = fused_margin(rows, "tracker", rate_Hz=250.0)
    assert (found.row, found.value) == (59, pytest.approx(39 / 250.0))
    rows["legs_lost"][40:90] = 1 << 2
    assert fused_margin(rows, "tracker").value == 0.0, "leg 2 may not be lost: its own fault comes first"


@pytest.mark.parametrize(
    ("lost", "mode", "faults", "age"),
    [
        (1 << 4, Mode.TRACKING, 0, 2),
        (1 << 3, Mode.TRACKING, 0, 900),
        (1 << 4 | 1 << 1, Mode.TRACKING, 0, 900),
        (1 << 4, Mode.UNLOADING, 0, 900),
        (1 << 4, Mode.FAULT, Fault.STALE, 900),
    ],
    ids=["may be lost", "may not", "too many", "proves a brake", "was the fault"],
)
def test_the_age_of_a_leg_that_may_be_lost_is_no_margin(lost, mode, faults, age):
    rows = rows_of(30)
    rows["age"][10, 0] = 2
    rows["age"][20] = [900 * (lost >> leg & 1) for leg in range(6)]
    rows["legs_lost"][20] = lost
    rows["mode"][20], rows["faults"][20:] = mode, faults
    assert fused_margin(rows, "age").value == age


def test_an_encoder_is_against_the_fused_pose_three_ticks_in_a_row_until_it_has_slipped():
    rows = rows_of(60)
    rows["legs_used"] = 0b111111
    rows["innovation_q"][5] = 1.0
    rows["legs_used"][20:22] = rows["legs_used"][30:] = 0b011111
    rows["innovation_q"][20:, 5] = -9e-5
    rows["innovation_q"][31:34, 5] = 8e-5, -7e-5, 6e-5
    rows["innovation_q"][34:, 5] = 1.0
    rows["legs_slipped"][33:] = 1 << 5
    found = fused_margin(rows, "against the fused pose")
    assert (found.row, found.leg, found.value) == (32, 5, pytest.approx(7e-5))


# -- peaks and spells ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [0, 1, 4999, 12345, 99_998, 99_999])
def test_thinning_out_keeps_a_peak_of_one_sample_and_its_place(at):
    t = np.linspace(0.0, 99.999, 100_000)
    y, z = np.sin(t), np.full(100_000, np.nan)
    y[at], z[at] = 50.0, -7.0
    x, (thin_y, thin_z) = thin(t, [y, z], bins=500)
    assert len(x) <= 1000
    assert (np.diff(x) >= 0).all()
    assert thin_y.max() == 50.0
    assert abs(x[np.argmax(thin_y)] - t[at]) <= 0.2
    assert np.nanmin(thin_z) == -7.0


def test_thinning_out_keeps_the_direction_of_a_curve():
    t = np.linspace(0.0, 1.0, 10_000)
    _, (rises, falls) = thin(t, [t**2, 1.0 - t**2], bins=100)
    assert (np.diff(rises) > 0).all()
    assert (np.diff(falls) < 0).all()


def test_few_samples_stay_as_they_are():
    t = np.arange(10, dtype=np.float64)
    x, (y,) = thin(t, [t**2], bins=5)
    assert (x == t).all()
    assert (y == t**2).all()


def test_spells_and_lanes_say_when_a_mode_or_bit_was_there():
    assert spells(np.array([1, 1, 4, 4, 4, 1])) == [(1, 0, 2), (4, 2, 5), (1, 5, 6)]
    rows = rows_of(10)
    rows["warnings"][3:5] = Warn.LATE | Warn.BUS
    rows["warnings"][7] = Warn.BUS
    assert [(lane.label, lane.ticks, lane.first) for lane in lanes(rows)] == [
        ("warnings LATE", 2, 3),
        ("warnings BUS", 3, 3),
    ]


# -- the story -----------------------------------------------------------------------------------------------


def test_the_page_opens_with_leg_value_limit_instant_reaction_and_advice(logs, tmp_path):
    out = tmp_path / "bad.html"
    summary = report(logs / "bad.mcap", out=out)
    assert summary["went_wrong"] == "latched fault ENCODER"
    text = out.read_text()
    opening = text[text.index("<main>") : text.index("Smallest margin")]
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
    assert "the brakes were told to close" in opening
    assert "RUN" in opening


def test_a_good_run_opens_with_its_margins(logs, tmp_path):
    out = tmp_path / "good.html"
    assert report(logs / "good.mcap", out=out)["went_wrong"] is None
    text = out.read_text()
    assert text.index("Parked without a fault") < text.index("Smallest margin") < text.index("Tracking")
    assert "What went wrong" not in text


def test_without_the_end_of_the_log_the_faults_come_from_its_rows():
    rows = rows_of(100)
    rows["mode"][60:], rows["faults"][60:] = Mode.FAULT, Fault.SPEED
    found = told({}, rows, RATE_Hz)
    assert found.done == ((0.06, "the drives were told to switch off"),)
    (bare,) = found.findings
    assert (bare.fault, bare.time_s, bare.mode) == ("SPEED", 0.06, "TRACKING")
    assert bare.page.endswith("#fault-speed")


@pytest.mark.parametrize(
    "story",
    [
        "",
        "{",
        "[]",
        "7",
        '{"findings": 3, "done": {}, "drives": "x"}',
        '{"findings": [null, 1, {"fault": {}}]}',
        "[" * 9999,
    ],
)
def test_a_story_that_is_none_of_ours_breaks_nothing(story):
    found = told({"summary": {"story": story}}, rows_of(5), RATE_Hz)
    assert "<" in sections.what_went_wrong(found)


def test_a_limit_beyond_all_numbers_is_no_line_of_a_chart():
    """The configuration in a damaged log may say 1e308 m, which are no number of mm."""
    t = np.arange(3.0)
    chart = Chart("key", "section", "title", "mm", (Curve("a", t),), levels=(np.inf, 5.0, -np.inf, np.nan))
    (found,) = drawn([chart], t)
    assert found["levels"] == [5.0]
    as_script(found)


def test_texts_of_a_log_are_escaped_wherever_they_stand():
    finding = dict.fromkeys(
        ("fault", "mode", "value", "limit", "unit", "limit_key", "text", "next", "page"), HOSTILE
    )
    story = {
        "findings": [finding],
        "done": [{"text": HOSTILE, "time_s": 1}],
        "drives": [{"state": HOSTILE, "age": 2}],
        "lines": [f"in the end: {HOSTILE}", f"next: {HOSTILE} ({HOSTILE})"],
    }
    found = told({"summary": {"story": json.dumps(story), "reason": HOSTILE}}, rows_of(5), RATE_Hz)
    event = Event(0, HOSTILE, HOSTILE)
    parts = [
        sections.opening(found, rows_of(5), HOSTILE),
        sections.what_went_wrong(found),
        sections.modes(rows_of(5), np.arange(5.0), [event])[-1],
        sections.limits([], np.arange(5.0), HOSTILE),
        sections.figures([(HOSTILE, HOSTILE)]),
        sections.timing([], [], [(HOSTILE, HOSTILE)], {"cpu": HOSTILE}, lockstep=False),
        tag("p", HOSTILE, title=HOSTILE),
    ]
    assert all("&lt;/script&gt;" in part for part in parts)
    assert not any("<script" in part for part in parts)
    assert "<" not in as_script({HOSTILE: [HOSTILE]})
    assert json.loads(as_script({HOSTILE: [HOSTILE]})) == {HOSTILE: [HOSTILE]}


# -- logs that are cut or strange ----------------------------------------------------------------------------


def test_a_cut_log_is_shown_as_far_as_it_goes_and_the_page_says_so(logs, tmp_path):
    whole = (logs / "good.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    summary = report(cut)
    assert summary["remark"] == f"the log is cut at {cut.stat().st_size} bytes, the end is missing"
    text = cut.with_suffix(".html").read_text()
    assert "This page shows what is there" in text
    assert "Parked without a fault" not in text
    assert sorted(tmp_path.iterdir()) == [cut.with_suffix(".html"), cut], "nothing else is left behind"


def test_a_damaged_log_is_shown_without_the_damaged_part_and_the_page_says_so(logs, tmp_path):
    content = bytearray((logs / "good.mcap").read_bytes())
    chunk = content.rindex(b"\x28\xb5\x2f\xfd", 0, len(content) // 2)  # zstd's magic number
    content[chunk + 1000] ^= 0x10
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content)
    summary = report(bad)
    assert "the log is damaged; " in summary["remark"]
    assert f" of {len(content)} bytes are lost" in summary["remark"]
    assert sorted(tmp_path.iterdir()) == [bad.with_suffix(".html"), bad], "nothing else is left behind"


def test_a_log_that_is_being_written_meanwhile_is_shown_as_it_was(logs, tmp_path, monkeypatch):
    whole = (logs / "good.mcap").read_bytes()
    growing = tmp_path / "growing.mcap"
    growing.write_bytes(whole[: len(whole) // 2])
    events = Log.events

    def grown(log):
        growing.write_bytes(whole)
        return events(log)

    monkeypatch.setattr(Log, "events", grown)
    assert "is cut at" in report(growing)["remark"]


def test_an_existing_page_stays_unless_force_is_given_and_a_log_stays_in_any_case(logs, tmp_path):
    out = tmp_path / "page.html"
    out.write_text("mine")
    with pytest.raises(LogError, match=r"exists and is not overwritten.*--force"):
        report(logs / "good.mcap", out=out)
    assert out.read_text() == "mine"
    report(logs / "good.mcap", out=out, force=True)
    assert out.read_text().startswith("<!doctype html>")
    before = (logs / "bad.mcap").read_bytes()
    with pytest.raises(LogError, match="no log is ever overwritten"):
        report(logs / "good.mcap", out=logs / "bad.mcap", force=True)
    assert (logs / "bad.mcap").read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"no log", b"\x89MCAP0\r\n" + bytes(500)])
def test_what_is_no_log_is_refused_in_one_message(tmp_path, content):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    result = CliRunner().invoke(main, ["report", str(path)])
    assert result.exit_code == 2
    assert result.output.startswith(f"hil: {path}: ")
    assert list(tmp_path.iterdir()) == [path]


def test_hil_sim_ends_by_naming_the_report(tmp_path):
    log = tmp_path / "a run.mcap"
    result = CliRunner().invoke(main, ["sim", "ideal", "--duration", "0.2", "--log", str(log)])
    assert result.output.splitlines()[-1] == f"look at it: hil report '{log}'"


EXTREMES = {"i": (-(2**63), -1, 2**40, 2**63 - 1), "f": (np.nan, np.inf, -np.inf, 1e308, -1e-310)}


@pytest.mark.parametrize("seed", broad(range(6), quick=3))
def test_any_numbers_in_a_log_give_a_page(logs, tmp_path, monkeypatch, seed):
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
    assert {"e_q", "tau", "mode"} & {chart["key"] for chart in json.loads(data)["charts"]}


@pytest.mark.parametrize("count", [1, 2, 33])
def test_a_log_of_few_ticks_of_any_content_gives_a_page(tmp_path, count):
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


def test_without_its_configuration_a_log_still_tells_what_went_wrong(logs, tmp_path, monkeypatch):
    monkeypatch.setattr(Log, "configuration", "nonsense: 1\n")
    out = tmp_path / "bare.html"
    summary = report(logs / "bad.mcap", out=out)
    assert "without the configuration there are no limits" in summary["remark"]
    text = out.read_text()
    assert "its encoder jumped" in text
    assert "without the configuration there are no limits" in text
    assert 'id="scene"' not in text


def test_commands_of_an_advice_are_set_as_code_and_a_lone_backtick_stays():
    assert prose("say `hil check`, then `<b>`") == "say <code>hil check</code>, then <code>&lt;b&gt;</code>"
    assert prose("a ` b") == "a ` b"
