"""The pose in 3D, on page and report: all of the robot is in the picture, whatever its size and the window's."""

from __future__ import annotations

import importlib.resources
import json
from itertools import product
from math import cos, radians, sin

import pytest

from tests.browser import Browser, needs_chromium

pytestmark = needs_chromium

SIZES_M = {
    "palm": (0.02, 0.01, 0.03),
    "desk": (0.12, 0.08, 0.2),
    "flat": (1.0, 0.9, 0.3),
    "tower": (1.2, 0.4, 6.0),
}
"""Radius of the base, radius of the platform, height."""
CANVASES = ((328, 300), (560, 380), (1100, 430), (240, 620))
"""Width, height in px; the first is the page's at a window of 360 px."""
PAGE = """<!doctype html><style>body { margin: 0 } canvas { display: block }</style>
<canvas id="scene"></canvas><script>
SCRIPT
let view, canvas;
const eye = [1, 0, 0, 0, 1, 0, 0, 0, 1];
function begin(base, platform, height, w, h) {
  const old = document.getElementById("scene");
  canvas = old.cloneNode(); old.replaceWith(canvas);
  Object.assign(canvas.style, { width: w + "px", height: h + "px" });
  view = makeScene(canvas, { t: [0], base, platform, p: [0, 0, height], R: eye, p_d: [0, 0, 0],
    R_d: new Array(9).fill(0), load: [0, 0, 0, 0, 0, 0] }, (x) => Float64Array.from(x));
  view.draw();
}
function to(p) {
  view.place({ p, R: eye, p_d: [0, 0, 0], R_d: new Array(9).fill(0), load: [0, 0, 0, 0, 0, 0], marks: [] });
}
function painted() {
  const w = canvas.width, h = canvas.height, data = canvas.getContext("2d").getImageData(0, 0, w, h).data;
  let box = [w, h, -1, -1];
  for (let y = 0; y < h; y += 1) for (let x = 0; x < w; x += 1) if (data[4 * (w * y + x) + 3])
    box = [Math.min(box[0], x), Math.min(box[1], y), Math.max(box[2], x), Math.max(box[3], y)];
  return box;
}
function turn(key) { canvas.dispatchEvent(new KeyboardEvent("keydown", { key })); }
</script>"""


def ring(radius):
    return [[radius * cos(radians(a)), radius * sin(radians(a)), 0.0] for a in (5, 115, 125, 235, 245, 355)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    script = importlib.resources.files("hil.app.watch").joinpath("assets", "scene.js").read_text("utf-8")
    (folder / "scene.html").write_text(PAGE.replace("SCRIPT", script), encoding="utf-8")
    with Browser() as browser:
        browser.open(folder / "scene.html")
        yield browser


def begin(browser, radius, top, height, w, h):
    browser.value(f"begin({json.dumps(ring(radius))}, {json.dumps(ring(top))}, {height}, {w}, {h})")


def fits(browser, w, h):
    """Assert that nothing touches the border; return what is drawn on of the width and height beside margins."""
    left, upper, right, lower = browser.value("painted()")
    assert left >= 2, (left, upper, right, lower)
    assert upper >= 2, (left, upper, right, lower)
    assert right < w - 2, (left, upper, right, lower)
    assert lower < h - 2, (left, upper, right, lower)
    return (right - left) / (w - 50), (lower - upper) / (h - 36)


@pytest.mark.parametrize(("name", "canvas"), list(product(SIZES_M, CANVASES)), ids=str)
def test_a_robot_of_any_size_fits_a_canvas_of_any_size_and_fills_it(browser, name, canvas):
    begin(browser, *SIZES_M[name], *canvas)
    assert max(fits(browser, *canvas)) > 0.75


def test_it_fits_from_wherever_it_is_looked_at(browser):
    begin(browser, *SIZES_M["desk"], 328, 300)
    for key, times in (("ArrowLeft", 8), ("ArrowUp", 12), ("ArrowRight", 16), ("ArrowDown", 20)):
        for _ in range(times):
            browser.value(f"turn('{key}')")
        assert max(fits(browser, 328, 300)) > 0.6, key
