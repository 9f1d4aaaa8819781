"""The areas: whose sources each one has, and which test files make claims about them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Area:
    """Globs below the project's root, the more specific test files first."""

    sources: tuple[str, ...]
    tests: tuple[str, ...]

    def source_files(self, root: Path = ROOT) -> list[str]:
        """Return the sources, below `root`, in the order of their names."""
        return sorted(set(_found(root, self.sources)))

    def test_files(self, root: Path = ROOT) -> list[str]:
        """Return the test files, each once, in the table's order."""
        return [f for f in dict.fromkeys(_found(root, self.tests)) if f not in WHOLE]


def _found(root: Path, globs: tuple[str, ...]) -> list[str]:
    found = []
    for pattern in globs:
        files = sorted(p.relative_to(root).as_posix() for p in root.glob(pattern) if p.suffix == ".py")
        if not files:
            raise SystemExit(f"tools/mutants/areas.py: no file matches {pattern!r}; correct the table")
        found += files
    return found


WHOLE = {
    "tests/hil/test_safety_mutation.py",
    "tests/loop/test_lockstep.py",
    "tests/replay/test_portability.py",
}
"""Files that compare whole logs or sources: what fails there names no claim, so it does not count."""

_LOOP = ("tests/loop/test_operate.py", "tests/loop/test_engage.py", "tests/loop/test_reactions.py")

AREAS = {
    "safety": Area(
        ("hil/safety/*.py",),
        (
            "tests/hil/test_safety*.py",
            "tests/hil/test_encoder*.py",
            "tests/hil/app/test_encoder*.py",
            "tests/loop/test_reactions.py",
        ),
    ),
    "cycle": Area(
        tuple(
            f"hil/loop/{name}.py"
            for name in (
                *("cycle", "parts", "ramps", "reference", "sight", "homing", "setup_moves", "clock"),
                *("effort", "learned", "drives_say", "latches", "daemon", "panel", "report"),
            )
        ),
        (
            "tests/hil/test_cycle*.py",
            "tests/hil/test_clock.py",
            "tests/hil/app/test_rate_selection.py",
            "tests/hil/test_homing.py",
            "tests/hil/test_reference.py",
            "tests/hil/test_stage_columns.py",
            "tests/hil/test_fusion*.py",
            "tests/hil/test_effort.py",
            "tests/hil/test_sight.py",
            "tests/hil/test_waiting.py",
            "tests/hil/test_learned.py",
            "tests/hil/test_drives_say.py",
            "tests/hil/test_latches.py",
            "tests/hil/test_daemon*.py",
            "tests/hil/test_panel.py",
            "tests/loop/test_daemon.py",
            "tests/loop/test_last_force.py",
            "tests/loop/test_release.py",
            "tests/loop/test_setpoints.py",
            *_LOOP,
        ),
    ),
    "modes": Area(
        tuple(
            f"hil/loop/{name}.py"
            for name in ("modes", "operating", "admission", "run_end", "obedience", "console")
        ),
        (
            "tests/hil/test_modes.py",
            "tests/hil/test_operating*.py",
            "tests/hil/test_jogging*.py",
            "tests/hil/test_admission*.py",
            "tests/hil/test_console.py",
            "tests/hil/test_cycle*.py",
            "tests/hil/test_way_back.py",
            "tests/loop/test_run_end*.py",
            "tests/loop/test_left_alone.py",
            "tests/loop/test_obedience.py",
            *_LOOP,
        ),
    ),
    "motion": Area(
        (
            *(f"hil/loop/{name}.py" for name in ("motion", "jogging")),
            "hil/trajectory/*.py",
        ),
        (
            "tests/hil/test_motion*.py",
            "tests/hil/test_jogging*.py",
            "tests/hil/test_way_back.py",
            "tests/hil/test_override*.py",
            "tests/hil/test_trajectory*.py",
            "tests/hil/test_live.py",
            "tests/hil/test_reference.py",
            "tests/hil/test_operating*.py",
            "tests/loop/test_operate.py",
            "tests/loop/test_paths.py",
            "tests/loop/test_setpoints.py",
        ),
    ),
    "drivers": Area(("drivers/**/*.py",), ("tests/drivers/test_*.py", "tests/hil/test_frames.py")),
    "plant_fmu": Area(("plant_fmu/**/*.py",), ("tests/plant_fmu/test_*.py", "tests/drivers/test_*.py")),
    "record": Area(
        tuple(
            f"hil/record/{name}.py"
            for name in (
                *("child", "encode", "environment", "figures", "layout", "live"),
                *(
                    "metrics",
                    "mirror",
                    "packer",
                    "publish",
                    "recorder",
                    "recording",
                    "ring",
                    "row",
                    "scene",
                    "schema",
                ),
            )
        ),
        (
            "tests/hil/test_ring.py",
            "tests/hil/test_mirror*.py",
            "tests/hil/test_figures.py",
            "tests/hil/test_metrics.py",
            "tests/hil/test_monitor.py",
            "tests/hil/test_foxglove_schemas.py",
            "tests/hil/test_scene.py",
            "tests/hil/test_publish.py",
            "tests/hil/test_row.py",
            "tests/hil/test_environment.py",
            "tests/hil/test_live.py",
            "tests/hil/test_recorder*.py",
            "tests/hil/test_log*.py",
            "tests/hil/test_salvage*.py",
            "tests/hil/test_record.py",
            "tests/hil/app/test_log_budget.py",
            "tests/hil/test_websocket.py",
        ),
    ),
    "replay": Area(
        (
            *("hil/loop/replay.py", "hil/app/replay.py", "hil/app/recorded_files.py", "hil/cli/replay*.py"),
            *(
                "hil/loop/what_if.py",
                "hil/study/what_if/*.py",
                "hil/study/against/*.py",
                "hil/study/replay_suite.py",
            ),
            "hil/record/divergence.py",
        ),
        (
            "tests/hil/test_divergence.py",
            "tests/replay/test_against.py",
            "tests/replay/test_suite.py",
            "tests/replay/test_what_if*.py",
            "tests/replay/test_replay.py",
            "tests/replay/test_tampered_log.py",
            "tests/replay/test_versions.py",
            "tests/hil/app/test_recorded_files.py",
            "tests/hil/app/test_bad_input.py",
            "tests/hil/app/test_controller_file.py",
        ),
    ),
    "salvage": Area(
        ("hil/record/salvage.py",),
        ("tests/hil/test_salvage*.py", "tests/hil/test_log*.py"),
    ),
    "log": Area(
        tuple(
            f"hil/record/{name}.py"
            for name in (
                *("log", "log_file", "mcap_file", "mcap_read"),
                *("data_frame", "entries", "selection", "unpack"),
            )
        ),
        (
            "tests/hil/test_mcap_file.py",
            "tests/hil/test_log*.py",
            "tests/hil/test_salvage*.py",
            "tests/hil/test_record.py",
            "tests/hil/study/test_export.py",
        ),
    ),
}
