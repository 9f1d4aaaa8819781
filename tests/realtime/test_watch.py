"""The live page of a real run: it shows the run and operates it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.signals import Mode
from hil.record.log import Log
from tests.browser import Browser, needs_chromium
from tests.live_run import Watch
from tests.realtime.rig import LASTING, Process, configuration

pytestmark = [pytest.mark.realtime(patient=True), needs_chromium]

Start = Callable[..., Process]


def until(browser: Browser, expression: str, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not browser.value(expression):
        assert time.monotonic() < end, f"still false: {expression}"
        time.sleep(0.1)


def mode_is(mode: Mode) -> str:
    return f"document.getElementById('mode-name').textContent === '{mode.name}'"


def click(browser: Browser, word: str) -> None:
    browser.value(f"document.querySelector('[data-line={word}]').click()")
    until(browser, f"document.getElementById('answer').textContent === '{word}: taken'")


POSITION = "[...document.querySelector('#pose tbody tr').cells].slice(1, 4).map((c) => Number(c.textContent))"
"""m, with four digits."""


@pytest.mark.long
@pytest.mark.parametrize("word", ["stop", "park"])
def test_buttons_of_hil_watch_hold_and_end_the_motion_of_a_running_platform(
    tmp_path: Path, start: Start, word: str
) -> None:
    file = configuration(tmp_path, LASTING | {"name: virtual": "name: virtual\nwatch: {operate: true}"})
    with Browser() as browser, Watch(str(file)) as watch:
        run = start("run", str(file), "--plant")
        browser.go(watch.link)
        until(browser, mode_is(Mode.TRACKING), 120.0)
        click(browser, "hold")
        until(browser, "/^0 % now/.test(document.getElementById('speed-now').textContent)")
        time.sleep(0.5)
        first = browser.value(POSITION)
        time.sleep(0.5)
        assert browser.value(POSITION) == pytest.approx(first, abs=2e-4), "the platform is at rest"
        assert browser.value(mode_is(Mode.TRACKING)), "brakes open, held by the law"
        click(browser, "start")
        until(browser, f"Math.abs({POSITION}[1] - {first[1]}) > 0.01")
        click(browser, word)
        until(browser, mode_is(Mode.PARKED))
        code, summary = run.wait(), run.summary
        assert code == 0, summary["trouble"]
        assert summary["replay"]["exact"]
        assert summary["dropped_ticks"] == 0
        assert browser.errors == []
    assert Log.open(summary["log"]).rows()["mode"][-1] == Mode.PARKED
