"""`hil design`: input files, output files, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.app.configuration.controller_file import read_controller
from hil.cli import main

ROOT = Path(__file__).resolve().parents[3]


SHIPPED = {name: (ROOT / f"configs/designs/{name}.yaml").read_text() for name in ("hinf", "mu")}


def design(*arguments, method="hinf"):
    return CliRunner().invoke(main, ["design", method, *map(str, arguments)])


def axis_file(folder, **changes):
    measured = {
        key: [1.0, 1.0]
        for key in ("frequency_Hz", "magnitude", "coherence", "magnitude_std", "phase_std_deg", "phase_deg")
    }
    model = {
        "kind": "axis-model",
        "source": "today.mcap",
        "axes": "joint",
        "rate_Hz": 1000,
        "nominal": {"gain": [1.0] * 5 + [1.1], "transport_ms": 0.45, "lag_ms": 0.7},
        "uncertainty": {"frequency_Hz": [1, 100], "bound": [0.05, 0.2]},
        "measured": [measured] * 6,
    }
    nominal = changes.pop("nominal", {})
    model["nominal"] |= nominal
    path = folder / "axis.yaml"
    path.write_text(json.dumps(model | changes))
    return path


@pytest.mark.parametrize("method", SHIPPED)
def test_hil_design_writes_controller_file_figures_and_picture(tmp_path, method):
    files = [tmp_path / name for name in ("c.yaml", "d.json", "d.png")]
    done = design(method, "-o", files[0], "--json", files[1], "--plot", files[2], method=method)
    assert done.exit_code == 0, done.output
    controller, summary = read_controller(files[0]), json.loads(files[1].read_text())
    assert controller.method == method
    assert summary["crossover_rad_s"] == controller.design["crossover_rad_s"]
    assert f"{summary['crossover_rad_s']:.1f} rad/s" in done.output
    assert files[2].read_bytes().startswith(b"\x89PNG")
    if method == "mu":
        assert summary["mu_upper"] == max(summary["mu"]["upper"])
        assert summary["mu_upper"] <= summary["mu_proven"] < 1.0
        assert f"states left out     {summary['states_left_out']}, of Hankel" in done.output
    else:
        assert design("hinf", "-o", files[0]).exit_code == 0, "an earlier controller is replaced"


def test_measured_axis_model_replaces_the_nominal_axis_in_hil_design(tmp_path):
    out = tmp_path / "c.yaml"
    done = design("hinf", "--model", axis_file(tmp_path), "-o", out)
    assert done.exit_code == 0, done.output
    axis = read_controller(out).design["axis"]
    assert axis["transport_ms"] == 0.45
    assert axis["gain"] == pytest.approx(1.1 ** (1 / 6))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rate_Hz": 500}, "rate_Hz: 500.0, allowed: as in the design, 1000.0"),
        ({"axes": "pose"}, "axes: pose, allowed: as in the design, joint"),
        ({"nominal": {"gain": [1, 1, 1, 1, 1, 2]}}, "within 20 % of their mean"),
        ({"nominal": {"gain": [1, 1, 0.6, 1, 1, 1]}}, "within 20 % of their mean"),
    ],
)
def test_hil_design_refuses_an_unsuitable_axis_model_file(changes, says, tmp_path):
    done = design("hinf", "--model", axis_file(tmp_path, **changes))
    assert done.exit_code == 2
    assert says in done.output


def test_design_guide_shows_the_real_output_of_hil_design():
    page = (ROOT / "docs/guides/design.md").read_text()
    block = page.partition("```text\n")[2].partition("```")[0]
    assert block.split() == design("hinf").output.split()


@pytest.mark.parametrize(
    ("method", "old", "new", "says"),
    [
        ("hinf", "low_m: 9.0e-5", "low_m: 5.0e-3", "low_m is 0.005, allowed: below peak_m"),
        ("hinf", "  transport_ms: 0.5 ", "  transport: 0.5 ", "missing unit: the key is transport_ms"),
        ("hinf", "[error, rate_error]", "[rate_error]", "inputs lacks error"),
        ("hinf", "[error, rate_error]", "[error]", "go together"),
        ("hinf", "limit_m_s2: 20", "limit_m_s2: -20", "weights.control.limit_m_s2"),
        ("hinf", "delay_order: 1", "delay_order: 1\nmodel: axis.yaml", "nominal and model both define"),
        ("hinf", "limit_m_s2: 20", "limit_m_s2: 5", "no controller meets the weights"),
        ("mu", "inertia: 0.2", "inertia: 1.0", "less than 1"),
        (
            "mu",
            "[0.5, 2.0]",
            "[2.0, 0.5]",
            "transport_ms goes from 2 to 0.5, allowed: the smaller value first",
        ),
        ("mu", "transport_ms: 1.25", "transport_ms: 2.5", "nominal.transport_ms: 2.5, allowed: within"),
        ("mu", "peak_m: 4.6e-3", "peak_m: 4.6e-4", "mu is not below"),
        (
            "mu",
            "low_m: 3.45e-5",
            "low_m: 2.484e-5",
            "mu is 1.009, with its peak at 0.00216 rad/s",
        ),  # below the grid
        ("mu", "rate_Hz: 1000", "rate_Hz: 1.0e-3", "look for a wrong unit"),
    ],
)
def test_invalid_design_is_refused_with_the_allowed_values(method, old, new, says, tmp_path):
    assert old in SHIPPED[method]
    path = tmp_path / "my.yaml"
    path.write_text(SHIPPED[method].replace(old, new, 1))
    done = design(path, "-o", tmp_path / "c.yaml", method=method)
    assert done.exit_code == 2
    assert says in " ".join(done.output.split())
    assert not (tmp_path / "c.yaml").exists()


def test_mu_refuses_a_design_without_uncertainty():
    done = design("hinf", method="mu")
    assert done.exit_code == 2
    assert "has no section uncertainty" in " ".join(done.output.split())
