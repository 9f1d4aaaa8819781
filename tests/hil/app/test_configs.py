"""Shipped configurations: valid, equal to their sources, and CiA 402 runs that replay."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest
import yaml

from hil.app.check.command import inspect
from hil.app.configuration import schema
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import platform_dict
from hil.app.configuration.text_file import shipped
from hil.app.sim.command import simulate
from tests.hil.app.texts import edited

ROOT = Path(__file__).parents[3]
BOOK = json.loads((ROOT / "tests/data/book_platform.json").read_text())
NAMES = [
    "bench", "desktop", "ideal", "lab", "lab-cia402", "socketcan", "two_buses", "vcan50", "virtual", "virtual-cia402",
]  # fmt: skip


class Floats(yaml.SafeLoader):
    """PyYAML, with support for the one number that its YAML 1.1 does not parse."""


Floats.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9.]+[eE][-+]?[0-9]+$"), list("-+0123456789.")
)


def test_exactly_the_listed_configurations_are_shipped():
    assert list(shipped()) == NAMES


@cache
def validator():
    committed = json.loads((ROOT / "configs/hil.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(committed)
    return jsonschema.Draft202012Validator(committed)


@pytest.mark.parametrize("name", NAMES)
def test_shipped_file_refers_to_its_schema_and_is_valid_by_it(name):
    text = load(name).text
    assert text.splitlines()[0] == "# yaml-language-server: $schema=hil.schema.json"
    validator().validate(yaml.load(text, Floats))


@pytest.mark.parametrize("name", ["bench", "ideal", "lab", "socketcan", "vcan50", "virtual"])
def test_every_shipped_configuration_passes_hil_check(name):
    c = load(name)
    report = inspect(c)
    json.dumps(report.to_dict())
    text = "\n".join(report.lines)
    assert ("time stamps of the kernel" in text) == (c.bus.interface == "socketcan")
    for word in ("robot at home", "bus", "watchdog", "reference", "real time on this machine"):
        assert word in text
    assert [w for w in report.warnings if "SCHED_FIFO" not in w] == []


def test_committed_json_schema_equals_the_generated_one():
    """To update: python -c 'from hil.app.configuration import schema; print(schema.text(), end="")' > configs/hil.schema.json."""
    assert (ROOT / "configs/hil.schema.json").read_text() == schema.text()


def test_json_schema_refuses_an_unknown_key():
    validator = jsonschema.Draft202012Validator(schema.schema())
    data = yaml.load(load("virtual").text, Floats)
    data["loop"]["rate"] = 1000
    assert not validator.is_valid(data)


@pytest.mark.parametrize("name", ["virtual", "ideal", "vcan50"])
def test_shipped_textbook_platform_has_the_published_joints_and_masses(name):
    d = platform_dict(load(name).platform)
    book = BOOK["geometry"]
    for key in ("base_joints", "platform_joints", "gravity"):
        assert np.array_equal(d[key], book[key])
    for body in ("platform", "cylinder", "rod"):
        for key, value in book[body].items():
            assert np.array_equal(np.array(d[body][key], object), np.array(_tuples(value), object))


def _tuples(value):
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


@pytest.mark.parametrize("name", ["virtual", "ideal"])
def test_shipped_textbook_path_has_the_published_way_points(name):
    reference: Any = load(name).reference
    assert reference.interpolation == "cubic"
    for point, knot in zip(reference.points, BOOK["trajectory"]["knots"], strict=True):
        assert (point.t_s, list(point.position_m), list(point.rotation_vector_deg)) == (
            knot["t"],
            knot["p"],
            knot["rotvec_deg"],
        )


PDO = ("velocity: difference", "velocity: pdo"), ("  rate_Hz: 400", "  rate_Hz: 312.5")


def configuration(name, *changes):
    return loads(edited(*changes, base=load(f"{name}-cia402").text), name)


@pytest.mark.parametrize(
    ("name", "changes", "peak_mm"),
    [
        ("virtual", (), 0.19),
        pytest.param("virtual", PDO, 0.26, marks=pytest.mark.long),
        pytest.param("lab", (), 2.3, marks=pytest.mark.long),
        pytest.param("lab", PDO, 2.3, marks=pytest.mark.long),
    ],
)
def test_run_of_a_shipped_configuration_tracks_parks_and_replays_exactly(name, changes, peak_mm, tmp_path):
    found = simulate(configuration(name, *changes), log=tmp_path / "run.mcap", duration_s=4.0)
    assert found["success"], found
    assert found["final_mode"] == "PARKED"
    assert found["rejected_frames"] == 0
    assert found["tracking"]["peak_leg_error_mm"] < peak_mm
    assert (found["replay"]["exact"], found["replay"]["wire_different_ticks"]) == (True, 0)
