"""The page of `hil report` in a browser: no error, no external request, keyboard, a phone's width."""

from __future__ import annotations

import hashlib
import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import load
from hil.app.configuration.fault_words import with_faults
from hil.app.sim.command import simulate
from hil.record.log import Log
from hil.study.report.command import report
from hil.study.report.page import asset
from tests.broad import broad
from tests.browser import CHROMIUM, Browser, needs_chromium

NOT_OURS = {
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "uPlot-LICENSE.txt": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}
"""SHA-256 of the files of the npm package uplot 1.6.32."""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Logs and pages of a good run of 1.5 s, and of one with an encoder jump."""
    folder = tmp_path_factory.mktemp("pages")
    good = simulate(load("virtual"), log=folder / "good.mcap", duration_s=1.5, check_replay=False)
    faulted = with_faults(load("virtual"), ("encoder_jump leg=3 at=2 by=5e-3",))
    bad = simulate(faulted, log=folder / "bad.mcap", duration_s=3.0, check_replay=False)
    assert (good["success"], bad["success"]) == (True, False)
    for name in ("good", "bad"):
        report(folder / f"{name}.mcap")
    return folder


@pytest.mark.long
def test_chromium_is_installed():
    assert CHROMIUM is not None, "apt install chromium: the tests of pages have not run"


@needs_chromium
@pytest.mark.parametrize("name", ["good", "bad"])
@pytest.mark.parametrize("width", broad([1200, 390], quick=1))
def test_a_page_opens_without_errors_external_requests_or_overflow(pages, tmp_path, name, width):
    file = pages / f"{name}.html"
    with Browser(width=width) as browser:
        browser.open(file)
        assert browser.errors == []
        assert set(browser.requests) == {file.resolve().as_uri()}
        assert browser.value("document.documentElement.scrollWidth") <= width
        drawn = browser.value(
            "[...document.querySelectorAll('.chart')].map((c) => [c.dataset.key, c.plot.data[1].length])"
        )
        assert {"Leg error [mm]", "Leg force [N]", "rotation", "mode", "bus"} <= {key for key, _ in drawn}
        assert all(count > 100 for _, count in drawn)
        assert browser.value("document.querySelector('.verdict').className") == f"verdict {name}"


@needs_chromium
@pytest.mark.long
def test_a_page_plays_and_zooms_with_the_keyboard(pages, tmp_path):
    with Browser() as browser:
        browser.open(pages / "good.html")
        browser.value("document.getElementById('play').focus()")
        browser.key("Enter", "\r")
        browser.value("new Promise((done) => setTimeout(done, 400))")
        browser.key("Enter", "\r")
        stopped = browser.value("Number(document.getElementById('time').value)")
        assert 0.05 < stopped < 5.0
        browser.value("new Promise((done) => setTimeout(done, 200))")
        assert browser.value("Number(document.getElementById('time').value)") == stopped
        whole = browser.value("document.querySelectorAll('.chart')[3].plot.scales.x.max")
        browser.value("document.querySelectorAll('.chart')[0].focus()")
        browser.key("+", "+")
        zoomed = browser.value("document.querySelectorAll('.chart')[3].plot.scales.x.max")
        assert zoomed == pytest.approx(0.75 * whole, rel=0.02), "all curves share one time axis"
        browser.key("0", "0")
        assert browser.value("document.querySelectorAll('.chart')[3].plot.scales.x.max") == pytest.approx(
            whole
        )
        browser.value("document.querySelector('.legend button').focus()")
        browser.key("Enter", "\r")
        assert browser.value("document.querySelectorAll('.chart')[0].plot.series[1].show") is False
        assert browser.errors == []


@needs_chromium
def test_a_chart_downloads_its_numbers_and_its_picture(pages, tmp_path):
    with Browser() as browser:
        browser.open(pages / "good.html")
        browser.value(
            "window.saved = []; URL.createObjectURL = (blob) => { saved.push(blob); return 'data:,'; };"
            "HTMLAnchorElement.prototype.click = () => {};"
        )
        force = "[...document.querySelectorAll('.chart')].find((c) => c.dataset.key === 'Leg force [N]')"
        for name in ("CSV", "PNG"):
            button = f"[...{force}.parentElement.querySelectorAll('.tools button')].find((b) => b.textContent === '{name}')"
            browser.value(f"{button}.click()")
        browser.value("new Promise((done) => setTimeout(done, 300))")
        head, *lines = browser.value("saved[0].text()").splitlines()
        assert head.startswith('"t [s]","leg 0, sent [N]","leg 1, sent [N]"')
        rows = Log.open(pages / "good.mcap").rows()
        found = np.array([[float(x or "nan") for x in line.split(",")] for line in lines])
        np.testing.assert_allclose(found[:, 1:7], rows["tau"], rtol=1e-5, atol=1e-3)
        picture = browser.value("saved[1].arrayBuffer().then((b) => [...new Uint8Array(b).slice(0, 8)])")
        assert bytes(picture) == b"\x89PNG\r\n\x1a\n"
        assert browser.errors == []


@needs_chromium
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_a_page_follows_the_colours_of_the_system_and_links_its_sections(pages, scheme):
    with Browser(width=390) as browser:
        browser.call(
            "Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}]
        )
        browser.open(pages / "bad.html")
        colour = browser.value("getComputedStyle(document.body).backgroundColor")
        assert (max(map(int, re.findall("[0-9]+", colour))) < 60) is (scheme == "dark")
        cut = "[...document.querySelectorAll('.scroll')].filter((b) => b.scrollWidth > b.clientWidth + 1).length"
        assert browser.value(cut) == 0, "no column is cut on a phone"
        titles = browser.value("[...document.querySelectorAll('.contents a')].map((a) => a.textContent)")
        assert titles[:4] == ["What went wrong", "Smallest margin of every limit", "Pose", "Errors"]
        missing = "[...document.querySelectorAll('.contents a')].filter((a) => !document.querySelector(a.hash)).length"
        assert browser.value(missing) == 0


@needs_chromium
def test_the_3d_view_plays_the_pose_of_the_log(pages, tmp_path):
    rows = Log.open(pages / "good.mcap").rows()
    at = int(np.argmax(rows["p"][:, 0]))
    t = float((rows["t_ns"][at] - rows["t_ns"][0]) * 1e-9)
    with Browser() as browser:
        browser.open(pages / "good.html")
        shown = (
            "(() => { const u = [...document.querySelectorAll('.chart')].find((c) => c.dataset.key === 'Position [m]').plot;"
            f" return u.data[4][u.valToIdx({t})]; }})()"
        )
        assert browser.value(shown) == pytest.approx(float(rows["p"][at, 0]), rel=1e-6)
        ink = (
            "(() => { const c = document.getElementById('scene');"
            " const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            " let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; })()"
        )
        assert browser.value(ink) > 2000, "base, platform and legs are drawn"


@needs_chromium
def test_a_rotated_platform_is_drawn_at_its_rotated_joints(pages, tmp_path):
    """x = p + R b: the picture equals that of a platform without rotation whose joints are at R b."""
    R = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
    joints = np.array(
        [[1, 0, 0], [0.6, 0.8, 0.1], [-0.5, 0.9, 0], [-1, 0, 0.2], [-0.5, -0.8, 0], [0.5, -0.9, 0]]
    )
    common = {
        "base": (2 * joints).tolist(),
        "t": [0.0],
        "p": [0.1, 0.2, 1.5],
        "p_d": [0, 0, 0],
        "R_d": [0] * 9,
    }
    turned = common | {"platform": joints.tolist(), "R": R.ravel().tolist(), "load": [0] * 6}
    plain = common | {"platform": (joints @ R.T).tolist(), "R": np.eye(3).ravel().tolist(), "load": [0] * 6}
    script = """((given) => {
        const lines = [], pen = new Proxy({}, { get: (_, name) => (...a) => {
            if (name === "moveTo" || name === "lineTo") lines.push(a); }, set: () => true });
        window.ResizeObserver = class { observe() {} };
        makeScene({ clientWidth: 600, clientHeight: 400, getContext: () => pen, addEventListener: () => {} },
            given, (numbers) => numbers).draw();
        return lines; })"""
    with Browser() as browser:
        browser.open(pages / "good.html")
        found, expected = (browser.value(f"{script}({json.dumps(given)})") for given in (turned, plain))
    assert len(found) == len(expected) > 60
    # faces may begin at another corner: the places that are drawn are the same
    one, other = (sorted(np.round(lines, 6).tolist()) for lines in (found, expected))
    np.testing.assert_allclose(one, other, atol=1e-5)


@needs_chromium
def test_text_of_a_log_never_becomes_markup(pages, tmp_path):
    hostile = '<img src=x onerror="document.title=1"><script>document.title=2</script>'
    page = (pages / "bad.html").read_text()
    name = tmp_path / "run<b>&\"'.mcap"
    name.write_bytes((pages / "bad.mcap").read_bytes())
    report(name)
    text = name.with_suffix(".html").read_text()
    assert "run<b>" not in text
    assert "run&lt;b&gt;&amp;&quot;&#x27;.mcap" in text
    (tmp_path / "forged.html").write_text(page.replace("</h1>", f"</h1>{hostile}"))
    with Browser() as browser:
        browser.open(tmp_path / "forged.html")
        browser.value("new Promise((done) => setTimeout(done, 100))")
        assert browser.value("document.title").startswith("bad.mcap"), "the policy runs no script but ours"


@pytest.mark.parametrize("name", NOT_OURS)
def test_third_party_assets_equal_their_released_files(name):
    assert hashlib.sha256(asset(name).encode()).hexdigest() == NOT_OURS[name]


def test_the_page_has_no_url_outside_licences(pages):
    text = (pages / "good.html").read_text()
    assert not re.search(r"""(?:src|href|url)\s*[=(]\s*["']?\s*(?:https?:)?//""", text)
    assert "Permission is hereby granted" in text
