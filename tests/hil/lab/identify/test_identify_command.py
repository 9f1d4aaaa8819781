"""`hil identify --delay`, against the delays built into the plant."""

import inspect
import json
from functools import cache
from math import pi

import pytest
import yaml
from click.testing import CliRunner

from hil.app.configuration.configuration import load
from hil.app.run.command import run_daemon
from hil.cli import main
from hil.lab.identify.axes import excited_axes
from hil.lab.identify.delay import excited
from tests.broad import broad

TRANSPORT_MS = 0.5
"""Rates latched 0.1 ms after the tick, force from 0.6 ms on, on the plant's grid of 0.1 ms."""
HOLD_MS = 0.5


def identify(*arguments):
    return CliRunner(env={"COLUMNS": "120"}).invoke(main, ["identify", *map(str, arguments)])


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """(result, log, summary) of the shipped bench, or of one with drives of half the bandwidth."""
    folder = tmp_path_factory.mktemp("identify")
    slow = load("virtual").text.replace("force_bandwidth_Hz: 200 ", "force_bandwidth_Hz: 100 ")
    (folder / "slow.yaml").write_text(slow)
    sources = {200.0: "virtual", 100.0: folder / "slow.yaml"}

    @cache
    def found(bandwidth_Hz):
        log, summary = folder / f"{bandwidth_Hz}.mcap", folder / f"{bandwidth_Hz}.json"
        result = identify(sources[bandwidth_Hz], "--delay", "--duration", 2, "--log", log, "--json", summary)
        assert result.exit_code == 0, result.output
        return result, log, json.loads(summary.read_text())

    return found


@pytest.mark.parametrize("bandwidth_Hz", broad([200.0, 100.0], quick=1))
def test_delay_built_into_the_virtual_plant_is_identified(measured, bandwidth_Hz):
    _, _, summary = measured(bandwidth_Hz)
    lag_ms = 1e3 / (2 * pi * bandwidth_Hz)
    assert summary["total_ms"] == pytest.approx(TRANSPORT_MS + lag_ms + HOLD_MS, abs=0.05)
    assert summary["transport_ms"] == pytest.approx(TRANSPORT_MS, abs=0.05)
    assert summary["lag_ms"] == pytest.approx(lag_ms, abs=0.05)
    assert summary["hold_ms"] == HOLD_MS
    assert summary["separable"]
    assert 0 < summary["total_std_ms"] < 0.05
    assert summary["gain"] == pytest.approx([1.0] * 6, abs=0.01)


def test_excitation_for_the_delay_is_small_and_its_log_gives_the_same_delay(measured, tmp_path):
    result, log, summary = measured(200.0)
    run = summary["run"]
    assert not any(run["limited_ticks"].values())
    assert run["replay"]["exact"]
    assert run["tracking"]["peak_leg_error_mm"] < 0.2
    block = yaml.safe_load(result.stdout[result.stdout.index("controller:") :])["controller"]
    assert block["delay_compensation"] == pytest.approx(summary["delay_compensation"])
    again = identify(log, "--delay", "--json", tmp_path / "a.json")
    assert again.exit_code == 0, again.output
    assert json.loads((tmp_path / "a.json").read_text())["total_ms"] == summary["total_ms"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["virtual", "--delay", "--model", "a.yaml"], "--model"),
        (["virtual", "--delay", "--force", "1e5"], "limits.force_step_N"),
        (["virtual", "--force", "1e5"], "limits.force_step_N"),
        (["virtual", "--duration", "5"], "at least 4"),
        (["bench"], "demands no acceleration"),
        (["virtual", "-o", "/nowhere/axes.yaml"], "/nowhere"),
        (["socketcan", "--delay"], "--run"),
        (["nothing.yaml", "--delay"], "no such file"),
    ],
)
def test_hil_identify_refuses_invalid_arguments_before_the_run(arguments, said, tmp_path):
    result = identify(*arguments, "--log", tmp_path / "a.mcap")
    assert result.exit_code == 2
    assert said in result.stderr
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("excite", [excited, excited_axes])
def test_identification_run_differs_only_in_name_and_reference(excite):
    """So its limits are those of `hil run`, and a stall has the same effect."""
    c = load("virtual")
    made, _ = excite(c, None, None)
    differ = {key for key in type(c).model_fields if getattr(made, key) != getattr(c, key)}
    assert differ == {"name", "reference"}


def test_identify_run_starts_the_daemon_like_hil_run(monkeypatch, tmp_path):
    """Rate selection, drives' watchdog, consent, plant: the same call except for picture and log file."""
    calls = []

    def daemon(*arguments, **options):
        bound = inspect.signature(run_daemon).bind(*arguments, **options)
        bound.apply_defaults()
        calls.append({k: v for k, v in bound.arguments.items() if k not in {"configuration", "draw", "log"}})
        return {"success": False, "trouble": "not run", "faults": [], "log": "none"}

    monkeypatch.setattr("hil.app.run.command.run_daemon", daemon)
    monkeypatch.setattr("hil.lab.identify.runs.run_daemon", daemon)
    identify("virtual", "--delay", "--run", "--plant", "--arm", "--log", tmp_path / "a.mcap")
    CliRunner().invoke(main, ["run", "virtual", "--plant", "--arm", "--log", str(tmp_path / "b.mcap")])
    of_identify, of_run = calls
    assert {k: v or None for k, v in of_identify.items()} == {k: v or None for k, v in of_run.items()}
    assert of_run["with_plant"]
    assert of_run["arm"]
