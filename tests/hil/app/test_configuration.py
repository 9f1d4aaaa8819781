"""Mistakes in a configuration: all reported at once, with file, line, column and path."""

from pathlib import Path
from typing import Any

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.text_file import shipped
from hil.app.configuration.yaml_positions import parse
from tests.hil.app.texts import VIRTUAL, edited


def problems(text, folder=None):
    with pytest.raises(ConfigurationError) as caught:
        loads(text, "my.yaml", folder)
    assert caught.value.problems
    assert str(caught.value) == "\n".join(caught.value.problems)
    return caught.value.problems


def place(text, needle):
    """`line:column` of the only occurrence of needle, counted from the text."""
    assert text.count(needle) == 1
    before = text[: text.index(needle)]
    return f"{before.count(chr(10)) + 1}:{len(before) - (before.rfind(chr(10)) + 1) + 1}"


ONE_PROBLEM = [
    ("rate_Hz: 1000\n", "rate: 1000\n", "rate: 1000\n", "loop.rate: missing unit: the key is rate_Hz"),
    ("watchdog_ms: 10 ", "watchdog_s: 10 ", "watchdog_s", "drives.watchdog_s: wrong unit: the key is watchdog_ms (in ms)"),
    ("channel: hil0", "chanel: hil0", "chanel", "bus.chanel: unknown key, did you mean channel?"),
    ("  following: sbc ", "  estop: sbc ", "estop: sbc", "reactions.estop: not a key: the reaction to estop, bus, second_controller is always sto"),
    ("  channel: hil0", "  options: {hardware_stamps: true}\n  channel: hil0", "true}", "bus.options.hardware_stamps: not for drives, allowed: on a bus of sensors, an entry of bus.channels without legs"),
    ("loop:\n", "lop:\n", "lop:\n", "lop: unknown key, did you mean loop?"),
    ("  priority: 80 ", "  zzz: 80 ", "zzz", "loop.zzz: unknown key, allowed: rate_Hz, feedback_window_us"),
    ("    mass_kg: 1150", "    mass: 1150", "mass: 1150", "platform.platform.mass: missing unit: the key is mass_kg"),
    ("  wn_rad_s: 20\n", "  wn_rad_s: .nan\n", ".nan", "controller.wn_rad_s: not a finite number, allowed: a number greater than 0 or a list of 6 numbers greater than 0, given: .nan"),
    ("  wn_rad_s: 20\n", "  wn_rad_s: [1, 2, 3, 4, 5]\n", "[1, 2, 3, 4, 5]\n", "controller.wn_rad_s: wrong number of entries, allowed: a list of 6 numbers greater than 0, given: 5 entries"),
    ("  wn_rad_s: 20\n", "  wn_rad_s: [1, 2, 3, 4, 5, -6]\n", "-6]", "controller.wn_rad_s[5]: out of range, allowed: a number greater than 0, given: -6"),
    ("  wn_rad_s: 20\n", "  wn_rad_s: quick\n", "quick", 'controller.wn_rad_s: wrong type, allowed: a number greater than 0 or a list of 6 numbers greater than 0, given: "quick"'),
    ("  wn_rad_s: 20\n", "  wn_rad_s: true\n", "true", "controller.wn_rad_s: wrong type"),
    ("  law: inverse_dynamics\n", "  law: idc\n", "idc", "controller.law: unknown value, allowed: cartesian_pd, "),
    ("  type: waypoints\n", "", "reference:", "reference.type: missing, allowed: hold, "),
    ("node_ids: [1, 2, 3, 4, 5, 6]", "node_ids: [1, 2, 3, 4, 5]", "[1, 2, 3, 4, 5]", "drives.node_ids: wrong number of entries, allowed: a list of 6 whole numbers, given: 5 entries"),
    ("node_ids: [1, 2, 3, 4, 5, 6]", "node_ids: [1, 2, 3, 4, 5, 5]", "[1, 2, 3, 4, 5, 5]", "drives.node_ids: two legs have the same node number"),
    ("node_ids: [1, 2, 3, 4, 5, 6]", "node_ids: [1, 2, 3, 4, 5, 128]", "128", "drives.node_ids[5]: out of range"),
    ("watchdog_ms: 10 ", "watchdog_ms: 2 ", "2                    # no command", "drives.watchdog_ms: shorter than three periods of loop.rate_Hz, allowed: at least 3, given: 2"),
    ("force_limit_N: 30000 ", "force_limit_N: 20000 ", "25000 ", "limits.force_N: above the drives' rated force, drives.force_limit_N, allowed: at most 20000, given: 25000"),
    ("length_min_m: 0.75", "length_min_m: 2.3", "2.3\n", "platform.length_min_m: not below platform.length_max_m, allowed: less than 2.2, given: 2.3"),
    ("stroke_margin_m: 0.02", "stroke_margin_m: 0.8", "0.8\n", "limits.stroke_margin_m: leaves no stroke between the soft ends, allowed: less than 0.725, given: 0.8"),
    ("priority: 80", "priority: 80.5", "80.5", "loop.priority: wrong type, allowed: a whole number at least 1 and at most 99, given: 80.5"),
    ('fmi_version: "3.0"', "fmi_version: 3.0", "3.0\n", "plant.model.fmi_version: unknown value, allowed: 2.0, 3.0, given: 3.0"),
    ("variant: full", "variant: precise", "precise", "controller.model.variant: unknown value, allowed: full, no_H, printed"),
    ("com_m: [0, 0, 0]", "com_m: [0, 0]", "[0, 0]\n", "platform.platform.com_m: wrong number of entries, allowed: a list of 3 numbers, given: 2 entries"),
    ("[0, 0, 285]]", "[0, 0, 28]]", "[[570, 0, 0], [0, 285, 0], [0, 0, 28]]", "platform.platform.inertia_kg_m2: got principal moments 28, 285, 570"),
    ("internal_step_us: 100", "internal_step_us: 300", "300\n", "plant.model.internal_step_us: the period is not a whole number of steps, allowed: 1000 us (loop.rate_Hz) divided by a whole number, as 250, given: 300"),
    ("position_m: [0.25, 0.5, 0.75], ", "position_m: [0.25, 0.5, 1.75], ", "{t_s: 1, ", "reference.points[1]: out of reach, allowed leg lengths: 0.77 to 2.18 m"),
    ("layout: fd ", "layout: classic ", "interface: localcan", "bus: the frames of one tick do not fit at 1 Mbit/s"),
    ("{t_s: 1, pos", "{t_s: 0, pos", "0, position_m: [0.25", "reference.points[1].t_s: 0 s is not after the previous point"),
    ("{t_s: 2, position_m: [0, 0, 1]", "{t_s: 2, position_m: [0, 0, 1.1]", "- {t_s: 0", "reference.points: periods is 10, but the path ends"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "where", "message"), ONE_PROBLEM, ids=[row[3][:60] for row in ONE_PROBLEM]
)
def test_each_mistake_in_the_yaml_is_reported_once_with_line_and_column(old, new, where, message):
    text = edited((old, new))
    (problem,) = problems(text)
    assert problem.startswith(f"my.yaml:{place(text, where)}: {message}")


def test_all_problems_of_a_configuration_are_reported_at_once_in_file_order():
    text = edited(
        ("    mass_kg: 1150", "    mass_kg: heavy"),
        ("channel: hil0", "chanel: hil0"),
        ("watchdog_ms: 10 ", "watchdog_ms: 1 "),
        ("damping_ratio: 1", "damping_ratio: -1"),
        ("  speed_m_s: 2 ", "  speed: 2 "),
        ("internal_step_us: 100", "internal_step_us: 300"),
    )
    found = problems(text)
    paths = [p.split(": ")[1] for p in found]
    assert paths == [
        "platform.platform.mass_kg",
        "bus.chanel",
        "drives.watchdog_ms",
        "controller.damping_ratio",
        "limits.speed",
        "plant.model.internal_step_us",
    ]


def test_missing_section_and_missing_key_of_a_configuration_are_reported():
    start, end = VIRTUAL.index("reference:"), VIRTUAL.index("limits:")
    text = edited(("  force_window_N: 12000 ", "  # "), base=VIRTUAL[:start] + VIRTUAL[end:])
    found = problems(text)
    assert len(found) == 2
    kinds = "hold, live, multisine, sampled, sinusoids, time_optimal, waypoints"
    assert found[0] == f"my.yaml:1:1: reference: missing, allowed: a section whose type is {kinds}"
    at = place(text, "limits:")
    assert found[1] == f"my.yaml:{at}: limits.force_window_N: missing, allowed: a number greater than 0"


SYNTAX = [
    ("name: a\nname: b\n", "2:1: name: key given twice, first in line 1: remove one of them"),
    ("bus:\n\tlayout: fd\n", "2:1: tab: YAML indents with spaces only"),
    ("a: [1, 2\nb: 3\n", "not YAML: while parsing a flow sequence"),
    ("", "1:1: the file is empty"),
    ("- 1\n- 2\n", "1:1: expected sections"),
    ("name: a\n---\nname: b\n", "2:1: a second document (`---`) is not allowed"),
    ("a: &x 1\nb: *x\n", "2:4: alias *x is not supported: write the value out"),
    (
        "name: !!python/name:os.system x\n",
        "1:7: name: tag tag:yaml.org,2002:python/name:os.system is not supported",
    ),
    ("name: a\x01\n", "1:8: character U+0001 is not allowed in YAML"),
    ('recording: {folder: "a\\0b"}\n', "1:21: recording.folder: character U+0000 is not allowed"),
    ("name: {<<: {a: 1}}\n", "1:8: name.<<: merging (<<) is not supported"),
    ("a: " + "[" * 3000 + "\n", "1:1: nested too deeply"),
    ("loop: {rate_Hz: " + "9" * 5000 + "}\n", "1:17: loop.rate_Hz: not a finite number"),
]


@pytest.mark.parametrize(("text", "message"), SYNTAX)
def test_text_that_is_not_plain_yaml_is_refused_with_its_place(text, message):
    assert any(message in p for p in problems(text))


def test_scalars_of_a_configuration_are_parsed_as_in_yaml_1_2():
    text = "[1e3, 1E-3, 010, 0o10, 0xff, no, 12:30, 1_000, ~, true, '5', -.5, 1., 1e400]"
    value: Any = (parse(f"a: {text}").value or {})["a"]
    expected = [1000, 0.001, 10, 8, 255, "no", "12:30", "1_000", None, True, "5", -0.5, 1.0, float("inf")]
    assert value == expected
    assert isinstance(value[0], int)


def test_error_for_a_missing_file_lists_the_shipped_configurations(tmp_path):
    with pytest.raises(
        ConfigurationError, match=r"no such file; shipped configurations are: .*ideal.*virtual"
    ):
        load(tmp_path / "none.yaml")
    with pytest.raises(ConfigurationError, match="cannot be read"):
        load(tmp_path)
    latin = tmp_path / "latin.yaml"
    latin.write_bytes("name: a\n# \u00e9".encode("latin-1"))
    with pytest.raises(ConfigurationError, match=r"latin\.yaml:2:3: not UTF-8 text"):
        load(latin)


def test_shipped_configuration_loads_by_name_unless_a_file_of_that_name_exists(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load("virtual").name == "virtual"
    assert {"virtual", "ideal", "socketcan", "lab"} <= set(shipped())
    Path("virtual").write_text(edited(("name: virtual\n", "name: mine\n")))
    assert load("virtual").name == "mine"


def test_exact_text_of_a_configuration_is_kept(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_bytes(VIRTUAL.replace("\n", "\r\n").replace("name: virtual", "description_: x", 0).encode())
    c = load(file)
    assert c.text.encode() == file.read_bytes()
    assert c.folder == tmp_path
    assert c.source == str(file)


LOCALCAN = "interface: localcan "


@pytest.mark.parametrize(
    ("name", "new", "command", "reason"),
    [
        ("virtual", "interface: virtual ", "run", "`virtual` bus exists inside one process"),
        ("virtual", "interface: virtual ", "plant", "`virtual` bus exists inside one process"),
        ("ideal", None, "run", "`ideal` takes no bus time"),
        ("socketcan", None, "sim", "this configuration is for real drives"),
        ("socketcan", None, "plant", "this configuration is for real drives"),
    ],
)
def test_configuration_without_what_a_command_needs_is_refused_with_the_reason(name, new, command, reason):
    c = load(name) if new is None else loads(edited((LOCALCAN, new)), "my.yaml")
    c.require("run" if name == "socketcan" else "sim")
    with pytest.raises(ConfigurationError, match=reason):
        c.require(command)


def step_us(text):
    """Plant step of a configuration."""
    return loads(text).model_dump()["plant"]["model"]["internal_step_us"]


@pytest.mark.parametrize("rate_Hz", [800, 700, 999])
def test_default_plant_step_divides_the_loop_period_into_at_least_ten_steps(rate_Hz):
    text = edited(("    internal_step_us: 100\n", ""), ("rate_Hz: 1000", f"rate_Hz: {rate_Hz}"))
    steps = 1e6 / rate_Hz / step_us(text)
    assert steps == pytest.approx(round(steps), rel=1e-12)
    assert 10.0 <= steps < 1e4 / rate_Hz + 1.0
