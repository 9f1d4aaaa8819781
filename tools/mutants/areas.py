"""The areas: which sources each one has, and which test files make claims about them."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WHOLE = {
    "tests/hil/test_safety_mutation.py",
    "tests/loop/test_lockstep.py",
    "tests/replay/test_portability.py",
}
"""Files that compare whole logs or sources: a failure there names no claim."""


def _in(folder: str, names: str) -> tuple[str, ...]:
    return tuple(f"{folder}/{name}.py" for name in names.split())


WHOLE = _in("tests", "hil/test_safety_mutation loop/test_lockstep replay/test_portability")
"""Files that compare whole logs or sources: a failure there names no claim."""
_LOOP = _in("tests/loop", "test_operate test_engage test_reactions")
_LOG = _in("tests/hil", "test_log* test_salvage* test_record")

AREAS = {
    "safety": (
        _in("hil/safety", "*"),
        (
            *_in("tests/hil", "test_safety* test_encoder* app/test_encoder*"),
            *_in("tests/loop", "test_reactions"),
        ),
    ),
    "cycle": (
        _in(
            "hil/loop",
            "cycle parts ramps reference sight homing setup_moves clock effort learned drives_say latches "
            "daemon panel report",
        ),
        (
            *_in(
                "tests/hil",
                "test_cycle* test_clock app/test_rate_selection test_homing test_reference "
                "test_stage_columns test_fusion* test_effort test_sight test_waiting test_learned "
                "test_drives_say test_latches test_daemon* test_panel",
            ),
            *_in("tests/loop", "test_daemon test_last_force test_release test_setpoints"),
            *_LOOP,
        ),
    ),
    "modes": (
        _in("hil/loop", "modes operating admission run_end obedience console"),
        (
            *_in(
                "tests/hil",
                "test_modes test_operating* test_jogging* test_admission* test_console test_cycle* "
                "test_way_back",
            ),
            *_in("tests/loop", "test_run_end* test_left_alone test_obedience"),
            *_LOOP,
        ),
    ),
    "motion": (
        (*_in("hil/loop", "motion jogging"), *_in("hil/trajectory", "*")),
        (
            *_in(
                "tests/hil",
                "test_motion* test_jogging* test_way_back test_override* test_trajectory* test_live "
                "test_reference test_operating*",
            ),
            *_in("tests/loop", "test_operate test_paths test_setpoints"),
        ),
    ),
    "drivers": (_in("drivers", "**/*"), (*_in("tests/drivers", "test_*"), *_in("tests/hil", "test_frames"))),
    "plant_fmu": (_in("plant_fmu", "**/*"), _in("tests", "plant_fmu/test_* drivers/test_*")),
    "record": (
        _in(
            "hil/record",
            "child encode environment figures layout live metrics mirror packer publish recorder recording "
            "ring row scene schema",
        ),
        (
            *_in(
                "tests/hil",
                "test_ring test_mirror* test_figures test_metrics test_monitor test_foxglove_schemas "
                "test_scene test_publish test_row test_environment test_live test_recorder* "
                "app/test_log_budget test_websocket",
            ),
            *_LOG,
        ),
    ),
    "replay": (
        _in(
            "hil",
            "loop/replay app/replay app/recorded_files cli/replay* loop/what_if study/what_if/* "
            "study/against/* study/replay_suite record/divergence",
        ),
        (
            *_in("tests/hil", "test_divergence app/test_recorded_files app/test_bad_input"),
            *_in(
                "tests/replay",
                "test_against test_suite test_what_if* test_replay test_tampered_log test_versions",
            ),
            *_in("tests/hil/app", "test_controller_file"),
        ),
    ),
    "salvage": (_in("hil/record", "salvage"), _in("tests/hil", "test_salvage* test_log*")),
    "log": (
        _in(
            "hil/record",
            "log log_file mcap_file mcap_read data_frame decode entries selection unpack",
        ),
        (*_in("tests/hil", "test_mcap_file study/test_export"), *_LOG),
    ),
}
"""Name -> globs of its sources and of its tests, below the project's root."""


def sources_of(area: str) -> list[str]:
    """Return the sources of an area, in the order of their names."""
    return sorted(set(_found(AREAS[area][0])))


def tests_of(area: str) -> list[str]:
    """Return the test files of an area, each once, in the order of the table."""
    return [file for file in dict.fromkeys(_found(AREAS[area][1])) if file not in WHOLE]


def _found(patterns: tuple[str, ...]) -> list[str]:
    found = []
    for pattern in patterns:
        files = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob(pattern))
        if not files:
            raise SystemExit(f"tools/mutants/areas.py: no file matches {pattern!r}; correct the table")
        found += files
    return found
