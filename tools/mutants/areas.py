"""Areas of the project: their sources, and the test files that have to notice mistakes in them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WHOLE = {
    f"tests/{name}.py"
    for name in ("hil/test_safety_mutation", "loop/test_lockstep", "replay/test_portability")
}
"""Files that compare whole logs or sources: a failure there says nothing about a single claim."""
AREAS = {
    "safety": (
        "hil/safety/*",
        "hil/test_safety* hil/test_encoder* hil/app/test_encoder* loop/test_reactions",
    ),
    "cycle": (
        """hil/loop/cycle hil/loop/parts hil/loop/reference hil/loop/sight hil/loop/homing
        hil/loop/clock hil/loop/effort
        hil/loop/latch_times hil/loop/daemon hil/loop/panel hil/loop/report""",
        """hil/test_cycle* hil/test_clock hil/app/test_rate_selection hil/test_homing hil/test_reference
        hil/test_stage_columns hil/test_fusion* hil/test_effort hil/test_sight hil/test_waiting
        hil/test_learned hil/test_report hil/test_latch_times hil/test_daemon* hil/test_panel
        loop/test_daemon loop/test_holding_force loop/test_release loop/test_setpoints loop/test_operate
        loop/test_engage loop/test_reactions""",
    ),
    "modes": (
        """hil/loop/modes hil/loop/operating hil/loop/admission hil/loop/run_end hil/loop/obedience
        hil/loop/console""",
        """hil/test_modes hil/test_operating* hil/test_jogging* hil/test_admission* hil/test_console
        hil/test_cycle* hil/test_way_back loop/test_run_end* loop/test_no_more_commands loop/test_obedience
        loop/test_operate loop/test_engage loop/test_reactions""",
    ),
    "motion": (
        "hil/loop/motion hil/loop/jogging hil/trajectory/*",
        """hil/test_motion* hil/test_jogging* hil/test_way_back hil/test_override* hil/test_trajectory*
        hil/test_live hil/test_reference hil/test_operating* loop/test_operate loop/test_paths
        loop/test_setpoints""",
    ),
    "drivers": ("drivers/**/*", "drivers/test_* hil/test_frames"),
    "plant_fmu": ("plant_fmu/**/*", "plant_fmu/test_* drivers/test_*"),
    "record": (
        """hil/record/child hil/record/encode hil/record/environment hil/record/figures hil/record/layout
        hil/record/metrics hil/record/mirror hil/record/packer hil/record/publish
        hil/record/recorder hil/record/recording hil/record/ring hil/record/row hil/record/scene
        hil/record/schema""",
        """hil/test_ring hil/test_mirror* hil/test_figures hil/test_metrics hil/test_monitor
        hil/test_foxglove_schemas hil/test_scene hil/test_publish hil/test_row hil/test_environment
        hil/test_live hil/test_recorder* hil/app/test_log_budget hil/test_websocket hil/test_log*
        hil/test_salvage* hil/test_record""",
    ),
    "replay": (
        """hil/loop/replay hil/app/replay hil/app/recorded_files hil/cli/replay* hil/loop/what_if
        hil/study/what_if/* hil/study/log_comparison hil/study/replay_suite hil/record/divergence""",
        """hil/test_divergence hil/app/test_recorded_files hil/app/test_bad_input replay/test_log_comparison
        replay/test_replay_suite replay/test_what_if* replay/test_replay replay/test_tampered_log
        replay/test_versions hil/app/test_controller_file loop/test_setpoints""",
    ),
    "salvage": ("hil/record/salvage", "hil/test_salvage* hil/test_log*"),
    "log": (
        """hil/record/log hil/record/log_file hil/record/mcap_file hil/record/mcap_read hil/record/data_frame
        hil/record/entries hil/record/selection hil/record/unpack""",
        "hil/test_mcap_file hil/study/test_export hil/test_log* hil/test_salvage* hil/test_record",
    ),
    "core": (
        "hil/robot/* hil/control/* hil/mathematics/* hil/estimation/*",
        """hil/test_dynamics* hil/test_kinematics hil/test_geometry hil/test_mathematics hil/control/test_*
        hil/test_estimate hil/test_observer hil/test_predict hil/test_fusion* hil/test_orientation_settings
        hil/test_effort hil/test_no_blas""",
    ),
    "design": (
        "hil/design/**/* hil/proof/**/*",
        "hil/design/**/test_* hil/proof/**/test_* hil/app/test_design*",
    ),
    "lab": (
        "hil/lab/**/*",
        "hil/lab/**/test_* loop/test_identification loop/test_payload loop/test_learning_runs",
    ),
    "study": ("hil/study/**/*", "hil/study/**/test_* hil/test_report replay/test_what_if*"),
    "app": ("hil/app/**/* hil/cli/*", "hil/app/test_*"),
}
"""Name of an area -> patterns of its sources, and of its tests below `tests`, without `.py`."""


def sources_of(area: str) -> list[str]:
    """Source files of an area, sorted by name."""
    return sorted(set(_matching(AREAS[area][0].split())))


def tests_of(area: str) -> list[str]:
    """Test files of an area, each once, in the order of the table AREAS."""
    found = _matching(f"tests/{name}" for name in AREAS[area][1].split())
    return [file for file in dict.fromkeys(found) if file not in WHOLE]


def _matching(patterns: Iterable[str]) -> list[str]:
    found = []
    for pattern in patterns:
        files = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob(f"{pattern}.py"))
        if not files:
            raise SystemExit(f"tools/mutants/areas.py: no file matches {pattern!r}; correct the table")
        found += files
    return found
