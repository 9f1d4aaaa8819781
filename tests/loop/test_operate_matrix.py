"""Operator commands in orders that may happen by accident: each run ends parked, and replays to the bit."""

from typing import Any

import numpy as np
import pytest

import hil
from drivers.signals import Mode
from hil.signals import JOG_NAMES

BRISK = {"setup_speed_m_s": 0.15, "setup_speed_deg_s": 20}
LAWS: dict[str, tuple[str, dict[str, Any]]] = {
    "lab": ("lab", {}),
    "sliding": (
        "lab",
        {
            "controller": {
                "law": "sliding_mode", "lambda_rad_s": 40, "boundary_layer_m_s": 0.02, "reaching_m_s2": 2.0,
                "uncertainty": {"disturbance_m_s2": 8.0},
            }
        },
    ),
    "pose": ("lab", {"controller": {"law": "pose_inverse_dynamics", "wn_rad_s": 40}}),
    "designed": ("virtual", {"controller": {"law": "state_space", "controller_file": "hinf"}}),
    "fused": (
        "virtual",
        {
            "sensors": {"tracker": {"rate_Hz": 200, "position_std_m": 1e-3, "orientation_std_deg": 0.1}},
            "estimation": {"pose": "fused"},
        },
    ),
}  # fmt: skip
"""Model-based and other laws, and a fused pose."""


def all_jogs():
    """Every axis and leg in both directions from hold, most of them up to a limit."""
    said, t = [(2.0, "hold")], 3.0
    for name in JOG_NAMES:
        for way in (1, -1):
            said.append((t, f"jog {name} {way} for 1.5"))
            t += 2.2
    return [*said, (t, "start"), (t + 4.0, "park")]


def key_lost(until_s):
    """The key is released then, and pressed again; start and park follow."""
    again = until_s + 0.8
    return [
        (0.0, f"key for {until_s}"), (again, "key for 12"), (again + 0.1, "start"), (again + 2.5, "park"),
        (again + 4.5, "park"),
    ]  # fmt: skip


SCRIPTS: dict[str, tuple[list[tuple[float, str]], dict[str, Any]]] = {
    "every jog": (all_jogs(), {}),
    "speed 0, then stop": ([(2.0, "speed 0"), (3.5, "stop")], {}),
    "park while paused": ([(2.5, "hold"), (3.5, "park")], {}),
    "hold, then reset": ([(2.5, "hold"), (3.5, "reset"), (3.7, "start"), (4.5, "stop")], {}),
    "two clients": (
        [
            (2.0, "hold"), (2.0, "start"), (2.5, "start"), (2.5, "hold"), (3.5, "jog x 1 for 0.5"),
            (3.501, "jog y 1 for 0.5"), (4.5, "park"), (4.5, "start"), (5.5, "park"), (5.5, "hold"),
            (6.5, "start"), (6.5, "park"),
        ],
        {},
    ),
    **{
        f"key lost in {mode}": (key_lost(t), {"deadman_s": 0.1})
        for mode, t in {"LOADING": 0.3, "RELEASING": 0.6, "APPROACH": 1.0, "TRACKING": 2.2}.items()
    },
    "key lost on the way back": (
        [(0.0, "key for 3.2"), (2.5, "park"), (4.8, "key for 12"), (4.9, "start"), (5.0, "park")],
        {"deadman_s": 0.1},
    ),
}  # fmt: skip


def operated(tmp_path, law, script):
    config, changes = LAWS[law]
    commands, settings = SCRIPTS[script]
    return hil.sim(
        config,
        commands=commands,
        log=tmp_path / "a.mcap",
        plant_log=False,
        operator=BRISK | settings,
        **changes,
    )


def check(run, script):
    assert run.success, run.summary["trouble"]
    assert run.summary["replay"]["different_ticks"] == 0
    counted = run.summary["commands"]
    assert counted["given"] + counted["not_reached"] == len(SCRIPTS[script][0]), (
        "the run may have parked before later commands"
    )
    assert counted["given"] > 1
    rows = run.log.rows()
    assert rows["mode"][-1] == Mode.PARKED
    assert not rows["faults"].any()
    return rows


def test_commands_of_two_operator_clients_in_one_period_act_in_sequence(tmp_path):
    """The last command of a tick counts; a jog of one client is not disturbed by another's."""
    rows = check(operated(tmp_path, "lab", "two clients"), "two clients")
    assert np.abs(rows["twist_d"][3100:3500]).max() == 0.0, "hold came last"
    jog = rows["twist_d"][3500:4100]
    assert ((jog[:, :3] != 0.0).sum(axis=1) <= 1).all(), "one axis at a time"


SOME = [
    (law, script) for n, script in enumerate(SCRIPTS) for k, law in enumerate(LAWS) if (k - n) % 5 in {0, 2}
]
"""Each script with two laws, each law with four scripts."""


@pytest.mark.long
@pytest.mark.parametrize(("law", "script"), SOME)
def test_run_with_any_operator_command_at_any_time_ends_parked(tmp_path, law, script):
    check(operated(tmp_path, law, script), script)
