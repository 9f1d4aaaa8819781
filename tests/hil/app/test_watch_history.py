"""Earlier runs on the live page: figures of the logs of a folder, their reports, two runs side by side."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from http import HTTPStatus

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.fault_words import with_faults
from hil.app.sim.command import simulate
from hil.app.watch.access import Refused
from hil.app.watch.history import History
from hil.record.log import Log
from hil.study.report.command import report
from tests.browser import Browser, needs_chromium
from tests.hil.app.test_watch_page import until
from tests.live_run import Watch

NONE = "none<img src=x onerror='document.title=1'>.mcap"
pytestmark = pytest.mark.usefixtures("meeting_place")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A good run with other gains, one with an encoder jump, a log that is cut, and a file that is not a log."""
    folder = tmp_path_factory.mktemp("runs")
    c = load("virtual")
    simulate(c, log=folder / "good.mcap", duration_s=1.7, check_replay=False)
    faulted = with_faults(c, ("encoder_jump leg=3 at=1.6 by=5e-3",))
    simulate(faulted, log=folder / "bad.mcap", duration_s=3.0, check_replay=False, plant_log=True)
    whole = (folder / "good.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (folder / NONE).write_bytes(b"not a log")
    return folder


def row_of(runs, name):
    return next(row for row in History(runs).runs()["runs"] if row["file"] == name)


def test_list_of_runs_has_duration_and_peak_error_of_the_ticks(runs):
    rows = Log(runs / "good.mcap").rows()
    tracking = rows[rows["mode"] == Mode.TRACKING]
    row = row_of(runs, "good.mcap")
    assert row["peak_error_mm"] == pytest.approx(1e3 * np.abs(tracking["q_d"] - tracking["q"]).max())
    assert row["duration_s"] == pytest.approx(1e-9 * (rows["t_ns"][-1] - rows["t_ns"][0]))
    assert (row["good"], row["verdict"], row["configuration"]) == (True, "parked", "virtual")
    assert row["law"] == "inverse_dynamics"


@pytest.mark.parametrize(
    ("name", "key", "word"),
    [
        ("bad.mcap", "verdict", "ENCODER"),
        ("cut.mcap", "verdict", "cut"),
        (NONE, "trouble", "not an MCAP"),
    ],
)
def test_list_of_runs_gives_the_reason_for_a_bad_run_and_a_damaged_log(runs, name, key, word):
    row = row_of(runs, name)
    assert word in row[key]
    assert not row.get("good")


def test_list_of_runs_leaves_out_logs_of_a_plant(runs):
    assert {row["file"] for row in History(runs).runs()["runs"]} == {
        "good.mcap", "bad.mcap", "cut.mcap", NONE,
    }  # fmt: skip


@pytest.mark.parametrize("path", ["/runs", "/report?run=good.mcap", "/report?run=..%2Fx.mcap"])
def test_history_is_refused_without_the_token(runs, path):
    with Watch("virtual", "--runs", str(runs)) as watch, pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(f"{watch.base}{path}")
    assert refused.value.code == HTTPStatus.UNAUTHORIZED
    refused.value.close()


@pytest.mark.parametrize("names", [[], ["../good.mcap"], ["/etc/passwd"], ["good.html"], ["good.mcap"] * 3])
def test_report_of_a_name_outside_the_folder_is_refused(runs, names):
    with pytest.raises(Refused) as refused:
        History(runs).page(names)
    assert refused.value.status == HTTPStatus.NOT_FOUND


def test_report_has_an_origin_of_its_own_and_cannot_reach_the_server(runs):
    with Watch("virtual", "--runs", str(runs)) as watch:
        cookie = {"Cookie": f"hil-watch-{watch.port}={watch.token}"}
        with urllib.request.urlopen(urllib.request.Request(f"{watch.base}/runs", headers=cookie)) as answer:
            assert len(json.load(answer)["runs"]) == 4
        address = f"{watch.base}/report?run=bad.mcap"
        with urllib.request.urlopen(urllib.request.Request(address, headers=cookie)) as answer:
            assert "sandbox" in answer.headers["Content-Security-Policy"]
            assert "allow-same-origin" not in answer.headers["Content-Security-Policy"]
            assert b"Went wrong: latched fault ENCODER on leg 3 at 1.600 s" in answer.read()


@needs_chromium
def test_live_page_without_a_run_lists_the_logs_and_opens_a_report(runs):
    with Watch("virtual", "--runs", str(runs)) as watch, Browser(width=390) as browser:
        browser.go(watch.link)
        until(browser, "document.querySelectorAll('#runs tbody tr').length === 4")
        assert browser.value("document.documentElement.scrollWidth") <= 390
        bad = (
            "[...document.querySelectorAll('#runs tbody tr')].find((r) => r.textContent.includes('bad.mcap'))"
        )
        assert "fault ENCODER" in browser.value(f"{bad}.textContent")
        assert browser.value("document.querySelectorAll('#runs img').length") == 0, "names are no HTML"
        cut = bad.replace("bad.mcap", "cut.mcap")
        assert browser.value(f"[...{cut}.cells].slice(4, 6).map((c) => c.textContent)") == ["–", "–"]
        assert "–: not in the summary" in browser.value("document.getElementById('history-note').textContent")
        assert browser.value("getComputedStyle(document.querySelector('.column')).display") == "none"
        browser.go(browser.value(f"{bad}.querySelector('a').href"))
        assert browser.value("document.querySelector('.verdict').className") == "verdict bad"
        until(browser, "document.querySelectorAll('.chart').length === charts.all.length")
        assert browser.errors == []


def test_two_runs_side_by_side_show_figures_and_different_keys(runs, tmp_path):
    changed = loads(with_changes(load("virtual").text, {"limits": {"speed_m_s": 1.75}}), "changed.yaml")
    simulate(changed, log=tmp_path / "changed.mcap", duration_s=1.7, check_replay=False)
    report(runs / "bad.mcap", tmp_path / "changed.mcap", out=tmp_path / "both.html")
    text = (tmp_path / "both.html").read_text()
    configuration = text.partition('<section id="configuration">')[2].partition("</section>")[0]
    assert "limits.speed_m_s" in configuration
    assert ">2.0<" in configuration
    assert ">1.75<" in configuration
    assert "law" not in configuration
    data = json.loads(text.partition('id="data">')[2].partition("</script>")[0])
    force = next(chart for chart in data["charts"] if chart["key"] == "Leg force [N]")
    assert [c["label"] for c in force["curves"]][::6] == ["leg 0, sent", "leg 0, sent, second"]
