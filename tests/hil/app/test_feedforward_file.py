"""File of a learned feed-forward: reading it, and runs that refuse it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect
from hil.app.compose import attachments, build_cycle
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.feedforward_file import feedforward_text, made_for, read_feedforward
from hil.app.recorded_files import with_attachments
from hil.app.stability.subject import Stated, Subject
from hil.config.feedforward import FeedforwardHead

pytestmark = pytest.mark.usefixtures("unproven")
VIRTUAL = load("virtual")
ROWS = np.round(100.0 * np.sin(np.arange(60.0)).reshape(10, 6), 4)


def head_of(c: Configuration, rows: int = 10) -> FeedforwardHead:
    return FeedforwardHead(
        kind="feedforward",
        source="first.mcap",
        run=1,
        made_for=made_for(c.reference, c.controller, c.platform, c.folder),
        rate_Hz=1000.0,
        cutoff_Hz=88.0,
        contraction=0.8,
        first_rms_error_mm=1.6,
        rms_error_mm=1.6,
        peak_N=100.0,
        rows=rows,
    )


TEXT = feedforward_text(head_of(VIRTUAL), ROWS, -4, 1e-3)


def using(folder: Path, text: str = TEXT, limit_N: float = 500.0, **changes: Any) -> Configuration:
    """The shipped configuration with a feed-forward of this text, and with other changes."""
    (folder / "learned.csv").write_text(text)
    section = {"feedforward": {"file": "learned.csv", "limit_N": limit_N}}
    return loads(with_changes(VIRTUAL.text, {"name": "virtual"} | section | changes), "my.yaml", folder)


def test_feedforward_file_is_read_with_its_header_forces_and_times() -> None:
    head, tau, start_s, step_s = read_feedforward(TEXT.encode(), "learned.csv")
    assert head == head_of(VIRTUAL).model_copy(update={"digest": head.digest})
    np.testing.assert_array_equal(tau, ROWS)
    assert (start_s, step_s) == pytest.approx((-4e-3, 1e-3))
    assert not tau.flags.writeable


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("# kind: feedforward", "# kind: axis-model", "kind"),
        ("# run: 1", "# run: 0", "run"),
        ("# peak_N: 100.0", "# peak_N: .nan", "peak_N"),
        ("# Made by", "Made by", "has no head"),
        ("-0.004,0.0000", "-0.004,nan", "truncated or changed"),
        ("-0.004,0.0000", "-0.004", "number of columns changed"),
        ("\n-0.002,", "\n-0.0025,", "truncated or changed"),
        (f"\n0.001,{ROWS[5, 0]:.4f}", f"\n0.001,{ROWS[5, 0] + 1e-4:.4f}", "truncated or changed"),
        ("# digest: ", "# digest: '0' #", "truncated or changed"),
    ],
)
def test_invalid_feedforward_file_is_refused_with_the_reason(old: str, new: str, said: str) -> None:
    assert TEXT.count(old) == 1, old
    with pytest.raises(ConfigurationError) as refused:
        read_feedforward(TEXT.replace(old, new).encode(), "learned.csv")
    assert "learned.csv" in str(refused.value)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("reference", {"reference": {"periods": 2}}),
        ("controller", {"controller": {"wn_rad_s": 21}}),
        ("controller", {"controller": {"model": {"inertia_scale": 0.9}}}),
        ("platform", {"platform": {"platform": {"mass_kg": 1100}}}),
        ("reference", {"platform": {"home": {"position_m": [0, 0, 1.01]}}}),
    ],
)
def test_feedforward_of_another_robot_or_path_is_refused(what: str, changes: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as refused:
        using(tmp_path, **changes)
    assert "my.yaml" in str(refused.value)
    assert f"feedforward.file: {tmp_path / 'learned.csv'}: was learned on another {what}" in str(
        refused.value
    )
    assert "learn again" in str(refused.value)


def test_missing_feedforward_file_is_refused_with_the_command_that_writes_one(tmp_path: Path) -> None:
    text = using(tmp_path).text
    (tmp_path / "learned.csv").unlink()
    with pytest.raises(ConfigurationError, match="allowed: a file of `hil learn`, given: ") as refused:
        loads(text, "my.yaml", tmp_path)
    assert f"given: learned.csv (looked for {tmp_path}/learned.csv)" in str(refused.value)


def test_feedforward_file_with_a_force_above_its_limit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigurationError, match=r"above feedforward\.limit_N, allowed: up to 90 N, given: 99"
    ):
        using(tmp_path, limit_N=90.0)


def test_log_contains_the_feedforward_file_and_replay_reads_it_from_the_log(tmp_path: Path) -> None:
    c = using(tmp_path)
    files = dict(attachments(c))
    assert files["feedforward.csv"] == TEXT.encode()
    (tmp_path / "learned.csv").unlink()
    (tmp_path / "replay").mkdir()
    again = with_attachments(loads(c.text, "log:config.yaml"), files, tmp_path / "replay")
    learned = build_cycle(again, 1000.0, 0.01).parts.learned
    assert learned is not None
    np.testing.assert_array_equal(learned.tau, ROWS)


REST = {"type": "hold", "duration_s": 0.5, "interpolation": None, "periods": None, "points": None}


def at_rest(folder: Path, size: float = 1.0) -> Configuration:
    """A configuration at rest with learned forces of this size."""
    c = loads(with_changes(VIRTUAL.text, {"name": "virtual", "reference": REST}), "my.yaml", folder)
    return using(folder, feedforward_text(head_of(c), size * ROWS, -4, 1e-3), 5000.0, reference=REST)


def test_check_warns_about_feedforward_forces_above_the_stated_disturbance(tmp_path: Path) -> None:
    report = inspect(at_rest(tmp_path, 48.0))
    assert [line for line in report.warnings if "the certificate may alarm" in line]


def test_stability_error_bound_states_that_it_excludes_the_feedforward_forces(tmp_path: Path) -> None:
    assert any(
        "up to 5000 N in a leg, is not in the bound" in line
        for line in Subject(at_rest(tmp_path), Stated()).unseen
    )
    assert not Subject(VIRTUAL, Stated()).unseen
