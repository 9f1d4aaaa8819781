"""`hil design mu`: files in, files out, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.app.configuration.controller_file import read_controller
from hil.cli import main

SHIPPED = (Path(__file__).resolve().parents[3] / "configs/designs/mu.yaml").read_text()


def design(*arguments):
    return CliRunner().invoke(main, ["design", "mu", *map(str, arguments)])


def test_the_command_writes_controller_bounds_and_picture(tmp_path):
    files = [tmp_path / name for name in ("c.yaml", "d.json", "d.png")]
    done = design("mu", "-o", files[0], "--json", files[1], "--plot", files[2])
    assert done.exit_code == 0, done.output
    controller, summary = read_controller(files[0]), json.loads(files[1].read_text())
    assert controller.method == "mu"
    assert summary["mu_lower"] <= summary["mu_upper"] == max(summary["mu"]["upper"])
    assert summary["mu_upper"] <= summary["mu_proven"] < 1.0
    assert f"states left out     {summary['states_left_out']}, of Hankel" in done.output
    assert f"{summary['mu_upper']:.4f}" in done.output
    assert files[2].read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("inertia: 0.2", "inertia: 1.0", "less than 1"),
        ("[0.5, 2.0]", "[2.0, 0.5]", "transport_ms goes from 2 to 0.5, allowed: from less to more"),
        ("transport_ms: 1.25", "transport_ms: 2.5", "nominal.transport_ms: 2.5, allowed: within"),
        ("peak_m: 4.6e-3", "peak_m: 4.6e-4", "mu is not below"),
        (
            "low_m: 3.45e-5",
            "low_m: 2.484e-5",
            "mu is 1.009, the worst at 0.00216 rad/s",
        ),  # far below the grid
        ("rate_Hz: 1000", "rate_Hz: 1.0e-3", "look for a wrong unit"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(tmp_path, old, new, message):
    assert old in SHIPPED
    (tmp_path / "my.yaml").write_text(SHIPPED.replace(old, new, 1))
    done = design(tmp_path / "my.yaml", "-o", tmp_path / "c.yaml")
    assert done.exit_code == 2
    assert message in " ".join(done.output.split())
    assert not (tmp_path / "c.yaml").exists()


def test_a_design_for_h_infinity_lacks_the_uncertainty():
    done = design("hinf")
    assert done.exit_code == 2
    assert "has no section uncertainty" in " ".join(done.output.split())
