"""The golden cases: settings of each run. A case in expected.json is never changed; cases are only added."""

from __future__ import annotations

from typing import Any

from tests.golden.fault_cases import FAULTY, SOON, STILL, Changes
from tests.golden.runner import Case
from tools.drive_families import FAMILIES, merged

FUSED: Changes = {
    **SOON,
    "sensors": {"tracker": {"rate_Hz": 200, "position_std_m": 1e-3, "orientation_std_deg": 0.1}},
    "estimation": {"pose": "fused", "fusion": {"may_lose_legs": [0, 1, 2, 3, 4, 5]}},
}


def law(name: str, **keys: Any) -> Changes:
    """Changes that select a law with its settings."""
    return {**SOON, "controller": {"law": name, **keys}}


CASES: dict[str, Case] = {}

# Shipped configurations: from the first tick to parked.
SIMULATED: Changes = {
    "plant": {"model": {"type": "stewart"}, "drives": {"brake_open_ms": 80, "brake_close_ms": 40}}
}
CASES |= {
    "shipped virtual": Case("virtual", duration_s=1.6),
    "shipped lab": Case("lab", duration_s=2.4, longest_s=4.0),
    "shipped desktop": Case("desktop", duration_s=2.4, longest_s=4.0),
    "shipped ideal": Case("ideal", duration_s=1.2),
    "shipped bench": Case("bench", duration_s=2.0, longest_s=4.0),
    "shipped two buses": Case("two_buses", duration_s=2.0, longest_s=2.2),
    "shipped virtual-cia402": Case("virtual-cia402", duration_s=2.4, longest_s=4.0),
    "shipped lab-cia402": Case("lab-cia402", duration_s=2.8, longest_s=4.0),
    "shipped vcan50": Case("vcan50", duration_s=3.0, longest_s=6.0),
    "shipped socketcan with a plant": Case("socketcan", SIMULATED, longest_s=4.0),
}

# Drive families.
CASES |= {
    f"family {name} on desktop": Case("desktop", changes, duration_s=1.7, longest_s=2.6)
    for name, changes in FAMILIES.items()
}
CLASSIC: Changes = {"bus": {"layout": "classic"}, "loop": {"rate_Hz": 400}}
PDO: Changes = {"drives": {"options": {"velocity": "pdo"}}, "loop": {"rate_Hz": 312.5}}
CASES |= {
    "family legs classic on virtual": Case("virtual", SOON | CLASSIC, duration_s=1.0),
    "family legs classic on lab": Case("lab", CLASSIC, duration_s=2.0),
    "family cia402 pdo on virtual": Case("virtual-cia402", SOON | PDO, duration_s=2.0),
    "family cia402 pdo on lab": Case("lab-cia402", PDO, duration_s=2.4),
}

# Laws.
PD: Changes = {"kp_N_m": 2.0e6, "kv_N_s_m": 5.0e4}
POSE: Changes = {
    "kp_position_N_m": 1.0e7, "kv_position_N_s_m": 2.0e5, "kp_rotation_N_m_rad": 1.0e7,
    "kv_rotation_N_m_s_rad": [1e5, 1.1e5, 1.2e5],
}  # fmt: skip
HOME: Changes = {"position_m": [0, 0, 1]}
LAWS: dict[str, Changes] = {
    "pd": law("pd", **PD),
    "pd with a mass and six gains": law("pd", kp_N_m=[2e6, 2.1e6, 2.2e6, 2e6, 1.9e6, 1.8e6], kv_N_s_m=5e4, feedforward_mass_kg=20),
    "pd_gravity": law("pd_gravity", **PD),
    "pid": law("pid", **PD, ki_N_m_s=2.0e7, integral_limit_N=8000),
    "pid that tracks its limits": law("pid", **PD, ki_N_m_s=2.0e7, integral_limit_N=3000, tracking_time_s=0.05),
    "feedforward_pd online": law("feedforward_pd", **PD),
    "feedforward_pd offline": law("feedforward_pd", **PD, evaluation="offline"),
    "inverse_dynamics no_H": law("inverse_dynamics", wn_rad_s=20, model={"variant": "no_H"}),
    "inverse_dynamics printed": law("inverse_dynamics", wn_rad_s=20, model={"variant": "printed"}),
    "inverse_dynamics constant_MG": law(
        "inverse_dynamics", wn_rad_s=20, model={"variant": "constant_MG", "frozen_at": HOME}
    ),
    "inverse_dynamics massless_legs": law("inverse_dynamics", wn_rad_s=20, model={"variant": "massless_legs"}),
    "inverse_dynamics with friction and damping ratio": law(
        "inverse_dynamics", wn_rad_s=[20, 22, 24, 20, 22, 24], damping_ratio=0.8,
        model={"inertia_scale": 0.9, "viscous_friction_N_s_m": 100, "coulomb_friction_N": 50, "reflected_mass_kg": 5},
    ),
    "inverse_dynamics with delay_compensation": law(
        "inverse_dynamics", wn_rad_s=30, delay_compensation={"bus_ms": 0.6, "drive_lag_ms": 0.8, "hold_ms": 0.5}
    ),
    "inverse_dynamics with the wrench observer": {
        **SOON, "estimation": {"wrench": {"source": "observer", "bus_ms": 0.6, "drive_lag_ms": 0.8}}
    },
    "inverse_dynamics with universal joints": {
        **SOON,
        "platform": {
            "leg_spin": "universal",
            "universal_joint_base_axes": [[0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]],
            "cylinder": {"inertia_axial_kg_m2": 0.5},
            "rod": {"inertia_axial_kg_m2": 0.1},
        },
    },
    "pose_inverse_dynamics": law("pose_inverse_dynamics", wn_rad_s=20),
    "partial_linearisation": law("partial_linearisation", wn_rad_s=20),
    "cartesian_pd shortest turn": law("cartesian_pd", **POSE),
    "cartesian_pd vector difference": law("cartesian_pd", **POSE, rotation_error="vector_difference", model={}),
    "robust_inverse_dynamics": law(
        "robust_inverse_dynamics", wn_rad_s=20, boundary_layer_m_s=0.5, uncertainty={"disturbance_m_s2": 8}
    ),
    "sliding_mode": law(
        "sliding_mode", lambda_rad_s=40, boundary_layer_m_s=0.05, reaching_m_s2=2,
        uncertainty={"disturbance_m_s2": 8, "model_error": 0.1, "acceleration_m_s2": 12},
    ),
    "state_space hinf": law("state_space", controller_file="hinf"),
    "state_space mu": law("state_space", controller_file="mu"),
    "state_space constant_hinf": law("state_space", controller_file="constant_hinf"),
    "state_space with its own integral": law("state_space", controller_file="../tests/data/controller.yaml"),
}  # fmt: skip
CASES |= {
    f"law {name}": Case("virtual", changes, duration_s=0.8, longest_s=1.5) for name, changes in LAWS.items()
}
CASES["law inverse_dynamics with the wrench observer"] = Case(
    "virtual", LAWS["inverse_dynamics with the wrench observer"], ["wrench_step mode=TRACKING at=0.2 force=300,0,-900"],
    duration_s=0.8, longest_s=1.5,
)  # fmt: skip

# References.
LIMITS: Changes = {
    "velocity_m_s": 0.3, "velocity_deg_s": 20, "acceleration_m_s2": 1, "acceleration_deg_s2": 60,
    "jerk_m_s3": 10, "jerk_deg_s3": 600,
}  # fmt: skip
POINTS = [
    {"t_s": 0, "position_m": [0, 0, 1]},
    {"t_s": 0.5, "position_m": [0.03, -0.02, 1.02], "rotation_vector_deg": [2, 3, -2]},
    {"t_s": 1, "position_m": [0, 0, 1]},
]
AXES = [
    {"axis": "x_m", "band_Hz": [1, 5], "lines": 4, "amplitude": 0.01},
    {"axis": "rz_deg", "band_Hz": [6, 9], "lines": 4, "amplitude": 0.5, "phases": "random", "seed": 3},
]
REFERENCES: dict[str, Changes] = {
    "hold": {"type": "hold", "pose": {"position_m": [0.01, 0.02, 1.01], "rotation_vector_deg": [1, 2, 3]}, "duration_s": 0.5},
    "cubic way-points": {"type": "waypoints", "interpolation": "cubic", "points": POINTS, "periods": 1},
    "quintic way-points": {"type": "waypoints", "interpolation": "quintic", "points": POINTS, "periods": 2},
    "minimum_jerk way-points": {"type": "waypoints", "interpolation": "minimum_jerk", "points": POINTS, "periods": 1},
    "time_optimal": {
        "type": "time_optimal", "limits": LIMITS,
        "points": [{"position_m": p} for p in ([0, 0, 1], [0.05, -0.05, 1.1], [0, 0, 1])],
    },
    "sinusoids": {
        "type": "sinusoids", "ramp_s": 0.5, "duration_s": 1.2,
        "components": [
            {"axis": "x_m", "amplitude": 0.05, "frequency_Hz": 0.8},
            {"axis": "ry_deg", "amplitude": 4, "frequency_Hz": 0.5, "phase_rad": 1.57},
        ],
    },
    "sinusoids offline": {
        "type": "sinusoids", "ramp_s": 0.5, "duration_s": 1.2, "evaluation": "offline",
        "components": [{"axis": "z_m", "amplitude": 0.05, "frequency_Hz": 0.8}],
    },
    "multisine": {"type": "multisine", "axes": AXES, "period_s": 1, "ramp_s": 0.2},
    "sampled": {"type": "sampled", "path": "../tests/golden/path.csv"},
}  # fmt: skip
CASES |= {
    f"reference {name}": Case("virtual", {**SOON, "reference": changes}, duration_s=1.3, longest_s=1.8)
    for name, changes in REFERENCES.items()
}
SETPOINTS = [
    (0.5, "setpoint 0.02 0 1.02"), (0.9, "setpoint 0 0.05 1 2 0 5"), (1.0, "setpoint 0 0 3"), (1.5, "setpoint 0 0 1"),
]  # fmt: skip
CASES["reference live with set-points"] = Case(
    "virtual", {**SOON, "reference": {"type": "live", "limits": LIMITS}}, commands=SETPOINTS, duration_s=2.0
)
CASES["reference live, then hold, start and park"] = Case(
    "virtual",
    {**SOON, "reference": {"type": "live", "limits": LIMITS}},
    commands=[
        (0.5, "setpoint 0.1 0 1.02"),
        (0.8, "hold"),
        (1.3, "start"),
        (1.4, "jog x 1 for 0.2"),
        (1.8, "park"),
    ],
    duration_s=2.6,
)
CASES["reference with a learned feed-forward"] = Case(
    "desktop",
    {"feedforward": {"file": "../tests/golden/feedforward.csv", "limit_N": 20}},
    commands=[(2.0, "speed 50")],
    duration_s=2.6,
    longest_s=3.5,
)

CASES |= FAULTY

# The operator.
STAYS: Changes = {**SOON, "operator": {"stays": True}}
ASKED: Changes = {**SOON, "operator": {"start": "asked", "setup_speed_m_s": 0.15, "setup_speed_deg_s": 20}}
KEY: Changes = {**SOON, "operator": {"deadman_s": 0.1}}
CASES |= {
    "operator holds, starts and goes on": Case("virtual", SOON, commands=[(0.6, "hold"), (1.4, "start")], duration_s=2.2),
    "operator at 40 percent, then 100": Case("virtual", SOON, commands=[(0.5, "speed 40"), (1.2, "speed 100")], duration_s=2.0),
    "operator at 0 percent, then stop": Case("virtual", SOON, commands=[(0.5, "speed 0"), (1.2, "stop")], duration_s=2.0),
    "operator parks": Case("virtual", SOON, commands=[(0.6, "park")], duration_s=2.5),
    "operator jogs axes from hold and parks": Case(
        "virtual", ASKED,
        commands=[(0.6, "jog x 1 for 0.3"), (1.1, "jog rz -0.5 for 0.3"), (1.6, "start"), (2.0, "park")], duration_s=2.7,
    ),
    "operator jogs legs from hold and starts": Case(
        "lab", ASKED,
        commands=[(1.0, "jog leg3 1 for 0.3"), (1.5, "jog leg0 -1 for 0.2"), (1.9, "start"), (2.5, "hold")], duration_s=2.8,
    ),
    "operator starts when asked": Case("virtual", ASKED, commands=[(0.7, "start")], duration_s=1.5),
    "operator orders what cannot be": Case(
        "virtual", SOON,
        commands=[(0.01, "start"), (0.1, "jog x 1"), (0.5, "reset"), (0.6, "setpoint 0 0 1"), (0.7, "release"), (0.8, "arm")],
        duration_s=1.1,
    ),
    "operator lets the key go and starts again": Case(
        "virtual", KEY, commands=[(0.0, "key for 0.6"), (1.2, "key for 1.5"), (1.3, "start")], duration_s=2.0
    ),
    "operator never holds the key": Case("virtual", KEY, commands=[(0.1, "start"), (0.6, "stop")], duration_s=1.0, longest_s=1.5),
    "operator strikes the emergency stop": Case("virtual", SOON, commands=[(0.6, "estop")], longest_s=1.6),
    "emergency stop with frames lost": Case(
        "virtual", SOON, ["frames_loss mode=TRACKING at=0.3 probability=0.3"], [(0.61, "estop")], longest_s=1.6
    ),
    "emergency stop at hold": Case("virtual", STILL, commands=[(0.45, "estop")], longest_s=1.2),
    "emergency stop while loading": Case("virtual", SOON, commands=[(0.1, "estop")], longest_s=1.2),
    "emergency stop while parking": Case("virtual", STILL, commands=[(0.55, "estop")], longest_s=1.2),
    "emergency stop on two buses": Case("two_buses", SOON, commands=[(0.8, "estop")], longest_s=1.2),
    "emergency stop of cia402 drives": Case("virtual-cia402", SOON, commands=[(1.0, "estop")], longest_s=2.5),
    "emergency stop of mit drives": Case("desktop", {}, commands=[(1.5, "estop")], longest_s=2.5),
    "emergency stop of moteus drives": Case("desktop", FAMILIES["moteus"], commands=[(1.5, "estop")], longest_s=2.5),
    "reset and a second start": Case(
        "virtual", STAYS, commands=[(0.1, "arm"), (0.6, "estop"), (1.2, "reset"), (1.5, "arm"), (1.6, "start"), (2.6, "stop"), (2.9, "end")],
        longest_s=3.5,
    ),
    "parks and starts again": Case(
        "virtual", STAYS, commands=[(0.1, "arm"), (0.5, "stop"), (1.6, "reset"), (1.7, "arm"), (1.8, "start"), (2.5, "stop"), (3.4, "end")], longest_s=3.5
    ),
    "reset of mit drives and a second start": Case(
        "desktop", STAYS, ["drive_reset leg=1 mode=TRACKING at=0.2 "],
        [(0.1, "arm"), (1.6, "reset"), (2.0, "arm"), (2.1, "start"), (3.0, "end")], longest_s=3.5,
    ),
    "held, and released": Case(
        "virtual", STAYS, ["brake_stuck_open leg=2 mode=PARKING"], [(0.1, "arm"), (0.5, "stop"), (1.7, "release"), (2.2, "end")], longest_s=3.0
    ),
    "a silent drive is held, and released": Case(
        "virtual", STAYS, ["drive_silence leg=2 mode=TRACKING at=0.2"], [(0.1, "arm"), (1.5, "release"), (2.0, "end")], longest_s=2.6
    ),
}  # fmt: skip

# Sensors, fusion, homing.
WRENCH: Changes = {
    **SOON,
    "bus": {"max_load_percent": 90},
    "sensors": {"wrench": {"rate_Hz": 500}, "imu": {"rate_Hz": 250}},
    "estimation": {"wrench": {"source": "sensor"}},
}
IMU: Changes = {
    **FUSED,
    "bus": {"max_load_percent": 90},
    "sensors": {**FUSED["sensors"], "imu": {"rate_Hz": 250}},
}
FORGETS: Changes = {
    "drives": {"homing": {"file": "real.yaml", "limit_m": 0.0005, "forgotten_turns": 0.1}, "transmission": {"offset_m": 0.3}},
    "plant": {"initial_position_m": [0, 0, 0.292]},
}  # fmt: skip
CASES |= {
    "fused pose": Case("virtual", FUSED, duration_s=0.9, longest_s=1.6),
    "fused pose with an IMU": Case("virtual", IMU, duration_s=0.6, longest_s=0.9),
    "fused pose loses an encoder": Case("virtual", FUSED, ["encoder_lost leg=1 mode=TRACKING at=0.2"], duration_s=0.8, longest_s=1.5),
    "fused pose with an encoder that slips": Case("virtual", FUSED, ["encoder_jump leg=1 by=0.005 mode=TRACKING at=0.2"], duration_s=0.8, longest_s=1.5),
    "fused pose with a silent drive": Case("virtual", FUSED, ["drive_silence leg=1 mode=TRACKING at=0.2"], duration_s=0.8, longest_s=1.5),
    "fused pose loses two encoders": Case(
        "virtual", FUSED, ["encoder_lost leg=1 mode=TRACKING at=0.2", "encoder_lost leg=4 mode=TRACKING at=0.25"], duration_s=0.8, longest_s=1.5
    ),
    "wrench from a sensor": Case("virtual", WRENCH, ["wrench_step mode=TRACKING at=0.2 force=500,0,-900"], duration_s=0.8, longest_s=1.5),
    "drives that forget their turns": Case("desktop", FORGETS, duration_s=1.8, longest_s=3.0),
}  # fmt: skip

# Inputs that no lockstep gives: the real-time loop's.
LATE = {k: {"lateness_ns": 40_000 * (k % 7), "compute_ns": 90_000} for k in range(200, 900, 3)}
CASES |= {
    "late and skipped ticks": Case(
        "virtual", SOON, duration_s=0.7, longest_s=1.4, altered={**LATE, 500: {"skipped": 1, "lateness_ns": 900_000}}
    ),
    "six ticks skipped at once": Case(
        "virtual", SOON, duration_s=0.7, longest_s=1.4, altered={500: {"skipped": 6, "lateness_ns": 6_400_000}}
    ),
    "a tick skipped five times in a row": Case(
        "virtual", SOON, duration_s=0.7, longest_s=1.4, altered={k: {"skipped": 1, "lateness_ns": 990_000} for k in range(500, 510, 2)}
    ),
    "sends fail, errors and an overflow": Case(
        "virtual", SOON, duration_s=0.7, longest_s=1.4,
        altered={400: {"sends_failed": 1}, 450: {"bus_errors": 3}, 480: {"bus_overflow": 2}, 500: {"stretched_ns": 3_000_000}, 520: {"recorder_dropped": 4}},
    ),
    "the recorder is lost": Case(
        "virtual", {**SOON, "recording": {"on_recorder_loss": "stop"}}, duration_s=0.9, longest_s=1.4,
        altered={k: {"recorder_alive": False} for k in range(500, 1400)},
    ),
}  # fmt: skip

# Combinations of two events.
LIVE: Changes = {"reference": {"type": "live", "limits": LIMITS}}
CASES |= {
    "law inverse_dynamics constant": Case(
        "virtual", law("inverse_dynamics", wn_rad_s=20, model={"variant": "constant", "frozen_at": HOME}), duration_s=0.6, longest_s=1.2
    ),
    "law pose_inverse_dynamics on lab": Case(
        "lab", merged(SOON, {"controller": {"law": "pose_inverse_dynamics", "wn_rad_s": 40}}), duration_s=0.8, longest_s=1.4
    ),
    "operator holds in the approach and starts": Case("virtual", SOON, commands=[(0.15, "hold"), (0.6, "start")], duration_s=1.2),
    "operator sets the speed at hold": Case(
        "virtual", SOON, commands=[(0.4, "hold"), (0.9, "speed 30"), (1.0, "start"), (1.3, "hold"), (1.3, "start")], duration_s=1.6
    ),
    "live set-points with a key that is let go": Case(
        "virtual", merged(KEY, LIVE), commands=[(0.0, "key for 0.7"), (0.4, "setpoint 0.1 0 1.05"), (1.1, "key for 0.5"), (1.2, "start")],
        duration_s=1.6, longest_s=2.4,
    ),
    "fused pose on two buses": Case(
        "two_buses", merged(FUSED, {"bus": {"max_load_percent": 90}, "loop": {"rate_Hz": 1000}}),
        ["encoder_lost leg=4 mode=TRACKING at=0.1"], duration_s=0.8, longest_s=1.2,
    ),
    "fused pose with a wrench sensor and a lost encoder": Case(
        "virtual", merged(FUSED, WRENCH, {"sensors": {"imu": None}}),
        ["encoder_lost leg=1 mode=TRACKING at=0.1", "wrench_step mode=TRACKING at=0.2 force=0,0,-300"], duration_s=0.6, longest_s=1.2,
    ),
    "brake_stuck_open while parking on two_buses": Case("two_buses", SOON, ["brake_stuck_open leg=4 mode=PARKING"], duration_s=0.5, longest_s=1.2),
    "frames_loss on virtual-cia402": Case(
        "virtual-cia402", SOON, ["frames_loss probability=0.1 for=0.3 mode=TRACKING at=0.1"], duration_s=1.0, longest_s=1.5
    ),
    "encoder_lost on moteus": Case(
        "desktop", merged(SOON, FAMILIES["moteus"]), ["encoder_lost leg=0 mode=TRACKING at=0.1"], duration_s=0.8, longest_s=1.3
    ),
    "drive_silence of odrive while loading": Case(
        "desktop", merged(SOON, FAMILIES["odrive"]), ["drive_silence leg=0 mode=LOADING"], duration_s=0.8, longest_s=1.2
    ),
    "frames_delay of cia402 pdo": Case(
        "desktop", merged(SOON, FAMILIES["cia402, pdo"]), ["frames_delay by=1 for=0.2 mode=TRACKING at=0.1"], duration_s=0.8, longest_s=1.3
    ),
    "a drive is silent for a while before it is armed": Case("virtual", SOON, ["drive_silence leg=5 for=0.05"], duration_s=0.6, longest_s=1.2),
    "a second start after a fault of the bus": Case(
        "virtual", STAYS, ["bus_off mode=TRACKING at=0.1 for=0.02"],
        [(0.1, "arm"), (0.9, "reset"), (1.3, "arm"), (1.4, "start"), (2.0, "end")], longest_s=2.8,
    ),
}  # fmt: skip

QUICK = {
    "shipped vcan50",
    "family legs classic on virtual",
    "family cia402, pdo on desktop",
    "drive_reset on mit, robstride rs-02",
    "drive_reset on moteus",
    "law sliding_mode",
    "law state_space hinf",
    "reference hold",
    "drive_silence while loading",
    "frames_forged_command at hold",
    "bus_off while parking",
    "silence of 5 ticks",
    "emergency stop with frames lost",
    "emergency stop on two buses",
    "operator at 0 percent, then stop",
    "fused pose with an IMU",
    "a tick skipped five times in a row",
}
"""Cases of the normal suite; all others are long."""
