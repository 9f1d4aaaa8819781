"""The live page in a browser: content, keyboard, emergency stop, held controls."""

from __future__ import annotations

import time

import numpy as np
import pytest

from drivers.signals import DriveFault, DriveState, Fault, Mode
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from hil.record.log import Log
from tests.broad import broad
from tests.browser import Browser, needs_chromium
from tests.live_run import Listening, LiveRun, Watch

pytestmark = [needs_chromium, pytest.mark.usefixtures("meeting_place")]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Rows in TRACKING."""
    path = tmp_path_factory.mktemp("watch") / "good.mcap"
    simulate(load("virtual"), log=path, duration_s=6.0, check_replay=False)
    found = Log.open(path).rows()
    return found[found["mode"] == Mode.TRACKING]


def until(browser, expression, seconds=60.0):
    end = time.monotonic() + seconds
    while not (value := browser.value(expression)):
        assert time.monotonic() < end, f"it did not come: {expression}"
        time.sleep(0.05)
    return value


def text(browser, name):
    return browser.value(f"document.getElementById('{name}').textContent")


@pytest.mark.parametrize("width", broad([360, 1200], quick=1))
def test_live_page_shows_a_run_without_script_errors_or_requests_to_other_hosts(rows, watch, width):
    with LiveRun(rows), Browser(width=width) as browser:
        browser.go(watch.link)
        until(browser, "watching.counts.drawn > 20")
        assert text(browser, "mode-name") == "TRACKING"
        assert text(browser, "link") == "● live"
        assert browser.value("document.body.classList.contains('stale')") is False
        assert browser.value("document.documentElement.scrollWidth") <= width
        assert browser.value("document.querySelectorAll('#legs tbody tr').length") == 6
        assert browser.value("document.querySelector('#events li').textContent") == "0.009 s, error: it broke"
        assert browser.value("document.querySelectorAll('#events b').length") == 0, "texts are no HTML"
        assert browser.value("document.getElementById('estop').hidden"), "this configuration does not operate"
        counts = browser.value("[...document.querySelectorAll('.chart')].map((c) => c.plot.data[1].length)")
        assert len(counts) == 4
        assert min(counts) > 10
        assert browser.errors == []
        assert {url.partition("?")[0].rpartition("/")[0] for url in browser.requests} == {watch.base}


def test_live_page_lists_faults_by_name_and_marks_their_legs(rows, watch):
    bad = rows[:1].copy()
    bad["mode"], bad["faults"] = Mode.FAULT, Fault.DRIVE | Fault.BRAKE
    bad["drive_fault"][0, 3], bad["legs_moved"] = DriveFault.OVERFORCE, 1 << 5
    bad["tau"][0, 1] = np.nan
    with LiveRun(bad), Browser() as browser:
        browser.go(watch.link)
        until(browser, "watching.counts.drawn > 5")
        assert browser.value("[...document.querySelectorAll('#faults li')].map((x) => x.textContent)") == [
            "DRIVE",
            "BRAKE",
        ]
        marks = browser.value("[...document.querySelectorAll('#legs .mark')].map((x) => x.textContent)")
        assert marks == ["", "", "", "✕ overforce", "", "✕ moved on its brake"]
        assert browser.value("document.querySelectorAll('#legs tbody tr')[1].cells[3].textContent") == "–"
        assert "drives are off" in text(browser, "waits")
        assert browser.errors == []


def test_live_page_shows_the_last_minute_from_before_it_was_opened(rows, watch):
    with LiveRun(rows) as run, Browser() as browser:
        end = time.monotonic() + 60.0
        while run.shown < 150:
            assert time.monotonic() < end
            time.sleep(0.05)
        browser.go(watch.link)
        until(browser, "watching.counts.drawn > 1")
        t, force, reported = browser.value(
            "['tau', 'tau', 'given'].map((name, k) => [...document.getElementById('plot-' + name).plot.data[k ? 3 : 0]])"
        )
    before = np.flatnonzero(np.asarray(t) < 1e-3 * rows["tick"][0] + 2.0)
    assert len(before) > 20, "earlier than the page"
    k = np.rint(1e3 * np.asarray(t)[before]).astype(int) - rows["tick"][0]
    np.testing.assert_allclose(np.asarray(force, float)[before], rows["tau"][k, 2], atol=1e-3)
    np.testing.assert_allclose(np.asarray(reported, float)[before], rows["drive_force"][k, 2], atol=1e-3)


def test_live_page_tells_a_hold_without_key_from_tracking_and_greys_what_does_nothing(rows, operated):
    still = rows[:1].copy()
    still["drive_state"], still["drive_force"], still["tau"] = DriveState.READY, 0.0, 79.8
    status = {"held": True, "key": "missing", "speed_percent": 100.0, "speed_now_percent": 0.0}
    with LiveRun(still), Listening(status=status), Browser() as browser:
        browser.go(operated.link)
        until(
            browser, "!document.getElementById('held').hidden && !document.getElementById('operating').hidden"
        )
        assert text(browser, "mode-name") == "TRACKING"
        assert text(browser, "held") == "on hold: the enabling key is not held"
        cells = browser.value(
            "[...document.querySelectorAll('#legs tbody tr')[0].cells].map((c) => c.textContent)"
        )
        assert cells[3:5] == ["79.8", "0.0"]
        assert "READY" in cells[7]
        grey = "[...document.querySelectorAll('[data-line]')].filter((b) => b.ariaDisabled === 'true').map((b) => b.dataset.line)"
        until(browser, f"{grey}.length > 0")
        assert browser.value(grey) == ["arm", "start", "hold", "park", "reset"]
        assert browser.value("document.getElementById('key').ariaDisabled") == "false"


@pytest.mark.long
def test_live_page_marks_stale_data_and_then_shows_the_next_run(rows):
    with Watch("virtual") as watch, Browser() as browser:
        browser.go(watch.link)
        until(browser, "document.getElementById('banner').textContent === 'nothing runs on this bus yet'")
        with LiveRun(rows, name="first") as run:
            until(
                browser,
                "document.getElementById('name').textContent === 'first' && watching.counts.drawn > 5",
            )
            run.freeze()
            until(browser, "/^no data for [1-9]/.test(document.getElementById('banner').textContent)")
            assert browser.value("document.body.classList.contains('stale')")
            assert text(browser, "link") == "○ waiting"
        until(browser, "/the run has ended/.test(document.getElementById('banner').textContent)")
        with LiveRun(rows, name="second"):
            until(browser, "document.getElementById('name').textContent === 'second'")
            until(browser, "!document.body.classList.contains('stale')")
            assert browser.value("document.getElementById('banner').hidden")
        assert browser.errors == []


def tab_to(browser, condition):
    for _ in range(40):
        browser.key("Tab")
        if browser.value(f"document.activeElement.matches({condition!r})"):
            return
    raise AssertionError(f"Tab does not reach {condition}")


@pytest.mark.long
def test_every_control_of_the_live_page_works_with_the_keyboard(rows, operated):
    with LiveRun(rows), Listening() as controller, Browser() as browser:
        browser.go(operated.link)
        until(browser, "!document.getElementById('estop').hidden && watching.counts.drawn > 5")
        assert browser.value("location.search") == "", "the token is not left in the address"
        browser.key("Tab")
        assert browser.value("document.activeElement.id") == "estop", "emergency stop first in tab order"
        assert browser.value("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        browser.key("Enter", "\r")
        for word in ("arm", "start", "hold", "stop", "park", "reset"):
            tab_to(browser, f"[data-line={word}]")
            browser.key("Enter", "\r")
        until(browser, "document.getElementById('answer').textContent === 'reset: taken'")
        assert controller.lines == ["estop", "arm", "start", "hold", "stop", "park", "reset"]
        tab_to(browser, "#speed")
        until(browser, "document.getElementById('speed-now').textContent === '55 % now, 40 % requested'")
        browser.key("End")
        until(browser, "document.getElementById('answer').textContent === 'speed 100: taken'")
        assert text(browser, "waits") == "waits for tests", "the page must show what the controller reports"
        assert browser.errors == []


SLOW = """
window.said = [];
window.fetch = (to, {body}) => new Promise((answer) => {
    said.push(JSON.parse(body).line);
    window.done = () => answer({ok: true, json: async () => ({taken: true, why: ""})});
});
"""


def test_emergency_stop_of_the_live_page_is_neither_delayed_nor_overtaken_by_other_commands(rows, operated):
    def click(*words):
        for word in words:
            browser.value(f"document.querySelector('[data-line={word}], button#{word}').click()")

    with LiveRun(rows), Browser() as browser:
        browser.go(operated.link)
        until(browser, "!document.getElementById('estop').hidden && watching.counts.drawn > 5")
        browser.value(SLOW)
        click("reset", "arm", "start")
        until(browser, "said.length === 1")
        browser.value("window.reset = done")
        click("estop", "hold")
        assert browser.value("said.join()") == "reset,estop", "emergency stop waits for no answer"
        browser.value("window.reset()")
        until(
            browser, "document.getElementById('answer').textContent.includes('the emergency stop came first')"
        )
        assert browser.value("said.join()") == "reset,estop", "queued commands dropped, later ones wait"
        browser.value("done()")
        until(browser, "said.length === 3")
        assert browser.value("said.join()") == "reset,estop,hold"


def press(browser, kind, key=" "):
    browser.call(
        "Input.dispatchKeyEvent", type=kind, key=key, code="Space", text=key if kind == "keyDown" else ""
    )


def not_shown(run, browser):
    """The data on the page become stale."""
    run.freeze()
    until(browser, "document.body.classList.contains('stale')")


LET_GO = {
    "key up": lambda run, b: press(b, "keyUp"),
    "focus": lambda run, b: b.value("document.activeElement.blur()"),
    "window": lambda run, b: b.value("window.dispatchEvent(new Event('blur'))"),
    "hidden": lambda run, b: b.value(
        "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
        "document.dispatchEvent(new Event('visibilitychange')); delete document.hidden;"
    ),
    "old data": not_shown,
}


@pytest.mark.long
def test_held_control_of_the_live_page_sends_its_command_until_released(rows, operated):
    with LiveRun(rows) as run, Listening() as controller, Browser() as browser:
        browser.go(operated.link)
        until(browser, "!document.getElementById('estop').hidden && watching.counts.drawn > 5")
        for how, let_go in LET_GO.items():
            controller.lines.clear()
            until(browser, "!document.body.classList.contains('stale')")
            browser.value("document.getElementById('key').focus()")
            press(browser, "keyDown")
            end = time.monotonic() + 30.0
            while len(controller.lines) < 5:
                assert time.monotonic() < end, f"{how}: {controller.lines}"
                time.sleep(0.05)
            assert set(controller.lines) == {"key"}
            let_go(run, browser)
            until(browser, "document.querySelectorAll('.held.down').length === 0")
            time.sleep(0.15)  # the one that is under way
            count = len(controller.lines)
            time.sleep(0.3)
            assert len(controller.lines) == count, how
            press(browser, "keyUp")
        assert browser.errors == []


def test_jog_control_of_the_live_page_also_sends_the_deadman_key(rows, operated):
    with LiveRun(rows), Listening() as controller, Browser() as browser:
        browser.go(operated.link)
        until(browser, "!document.getElementById('estop').hidden && watching.counts.drawn > 5")
        browser.value("document.getElementById('jogging').open = true")
        browser.value("document.querySelector('[aria-label=\"jog x −\"]').focus()")
        press(browser, "keyDown")
        until(browser, "document.querySelectorAll('.held.down').length === 1")
        time.sleep(0.5)
        press(browser, "keyUp")
        assert controller.lines[0] == "key"
        assert set(controller.lines) == {"key", "jog x -0.25"}
