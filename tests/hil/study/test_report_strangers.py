"""A story that is not one of ours: any number that JSON can hold gives a page, and none a traceback."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.record.schema import SUMMARY
from hil.study.report import sections
from hil.study.report.story import told
from tests.hil.study.test_report_figures import rows_of

HUGE = int("7" * 400)
NUMBERS = [
    HUGE,
    -HUGE,
    10**4299,
    1.7e308,
    -1.7e308,
    1e-320,
    2**63,
    -1,
    True,
    "7" * 400,
    None,
    [HUGE],
    {"a": HUGE},
]
FIELDS = ["time_s", "value", "limit", "leg", "mode", "fault", "text", "unit"]
ROWS = rows_of(9, mode=Mode.FAULT)
CODES = [HUGE, -HUGE, 10**4299, 2**63, -1]


def page(story, protocol=None, rate_Hz=1000.0):
    found = told({SUMMARY: {"story": json.dumps(story)}}, ROWS, rate_Hz, protocol)
    return found, str(sections.what_went_wrong(found))


@pytest.mark.parametrize("rate_Hz", [1000.0, 1e5, 1e-300])
@pytest.mark.parametrize("number", NUMBERS, ids=range(len(NUMBERS)))
def test_a_finding_may_have_any_number_anywhere(number, rate_Hz):
    """One that no field can hold leaves what the rows show: here no fault, and no traceback."""
    for name in FIELDS:
        finding: dict[str, Any] = {"fault": "STALE", "time_s": 0.003, "unit": "m"} | {name: number}
        found, _ = page(
            {"findings": [finding], "done": [{"time_s": number, "text": "stopped"}]}, None, rate_Hz
        )
        assert [each.fault for each in found.findings] in ([], ["STALE"], [number])


@pytest.mark.parametrize("name", ["virtual", "virtual-cia402", "two_buses", "desktop"])
@pytest.mark.parametrize("number", [*CODES, 2**62, 0], ids=range(len(CODES) + 2))
def test_a_drive_may_have_reported_any_number(number, name):
    c = load(name)
    protocol = build_protocol(c.bus, c.drives)
    drives = [{"state": "FAULT", "fault": number, "age": number}] * 6
    found, _ = page({"findings": [{"fault": "DRIVE"}], "drives": drives}, protocol)
    assert len(found.drives) == (6 if 0 <= number < 2**63 else 0)


@pytest.mark.parametrize(("time_s", "row"), [(0.003, 3), (0.0034, 3), (0.0036, 4), (0.008, 8), (-1e308, 0)])
def test_what_the_drives_said_is_that_of_the_tick_at_the_time_of_the_first_finding(time_s, row):
    rows = rows_of(9, mode=Mode.FAULT)
    rows["tick"], rows["drive_state"] = np.arange(9), 100 + np.arange(9)[:, None]
    story = json.dumps({"findings": [{"fault": "STALE", "time_s": time_s}]})
    assert told({SUMMARY: {"story": story}}, rows, 1000.0).drives == (str(100 + row),) * 6
