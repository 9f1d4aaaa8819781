"""The physics of our plant: energy, brakes, friction, stops, lag, state."""

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

HOME_FORCE = 3618.625746233  # N per leg at home, book platform (MuJoCo)


def energy(plant, force):
    return plant.get("kinetic_energy")[0] + plant.get("potential_energy")[0] - force @ plant.get("length")


def test_home_pose_is_in_balance_at_the_known_static_force(direct):
    plant = direct()
    plant.start(force=np.full(6, HOME_FORCE), brake=np.zeros(6))
    assert np.abs(plant.get("acceleration")).max() < 1e-8


@pytest.mark.parametrize("leg_spin", ["none", "universal"])
def test_energy_of_a_frictionless_swinging_platform_drifts_by_less_than_1e_10_in_10_s(direct, leg_spin):
    plant = direct()
    # gravity pulls away from the base: the platform hangs on its legs
    plant.set(gravity=[0, 0, 9.81], initial_twist=[0.5, -0.4, 0.45, 0.1, -0.2, 0.15], leg_spin=leg_spin)
    plant.set(universal_joint_base_axes=[[1, 0, 0]] * 6, cylinder_inertia=[0.5, 16.0], rod_inertia=[0.2, 4.1])
    force = np.full(6, -HOME_FORCE)
    plant.start(force=force, brake=np.zeros(6))
    e0, drift, peak = energy(plant, force), 0.0, 0.0
    for _ in range(100):
        plant.step(0.1)
        peak = max(peak, plant.get("kinetic_energy")[0])
        drift = max(drift, abs(energy(plant, force) - e0))
    assert peak > 300.0
    assert drift < 1e-10 * peak


def test_brakes_hold_the_platform_for_10_s_within_a_micrometre(direct):
    plant = direct()
    plant.start()  # brakes are engaged by default
    q0 = plant.get("length")
    plant.step(0.1, 100)
    assert np.abs(plant.get("length") - q0).max() < 1e-6
    assert np.abs(plant.get("rate")).max() < 1e-9


def test_brake_weaker_than_its_load_slips(direct):
    plant = direct()
    plant.set(brake_force=np.full(6, 0.9 * HOME_FORCE))
    plant.start()
    plant.step(0.1)
    assert plant.get("position")[2] < 1.0 - 1e-3


def test_brakes_stop_a_moving_platform_within_their_largest_force(direct):
    plant = direct()
    plant.set(initial_twist=[0.3, -0.2, 0.6, 0.2, 0.1, -0.3], brake_force=np.full(6, 8000.0))
    plant.start()
    stopped, rates = None, [plant.get("rate")]
    e0 = plant.get("kinetic_energy")[0] + plant.get("potential_energy")[0]
    travel, q = np.zeros(6), plant.get("length")
    for k in range(2000):
        plant.step(1e-4)
        travel += np.abs(plant.get("length") - q)
        q = plant.get("length")
        rates.append(plant.get("rate"))
        if stopped is None and np.abs(rates[-1]).max() < 1e-9:
            stopped = k
    assert stopped is not None
    assert np.abs(rates[-1]).max() < 1e-9
    # the lost energy is the work of friction: at most brake_force times travel, and more than half of it
    work = e0 - plant.get("kinetic_energy")[0] - plant.get("potential_energy")[0]
    assert 0.0 < work <= 8000.0 * travel.sum() * (1 + 1e-6)
    assert work > 0.5 * 8000.0 * travel.sum()


def test_leg_sticks_below_its_coulomb_friction_force_and_slides_above(direct):
    plant = direct()
    plant.set(coulomb_friction=np.full(6, 100.0))
    plant.start(force=np.full(6, HOME_FORCE + 99.0), brake=np.zeros(6))
    plant.step(0.1)
    assert np.abs(plant.get("rate")).max() < 1e-9
    plant.set(force=np.full(6, HOME_FORCE + 300.0))
    with_friction = plant.get("acceleration")
    free = direct()
    free.start(force=np.full(6, HOME_FORCE + 200.0), brake=np.zeros(6))
    assert with_friction == pytest.approx(free.get("acceleration"), rel=1e-6, abs=1e-6)


def test_viscous_friction_force_of_a_leg_is_minus_b_times_its_rate(direct):
    twist = [0.1, 0.2, -0.3, 0.1, 0.0, 0.2]
    b = np.array([100.0, 200.0, 300.0, 400.0, 500.0, 600.0])
    damped, free = direct(), direct()
    damped.set(viscous_friction=b, initial_twist=twist)
    damped.start(brake=np.zeros(6))
    free.set(initial_twist=twist)
    free.start(brake=np.zeros(6), force=-b * damped.get("rate"))
    assert damped.get("acceleration") == pytest.approx(free.get("acceleration"), rel=1e-12)


@pytest.mark.parametrize("name", ["coulomb_friction", "brake_force"])
def test_dry_friction_and_brake_force_may_differ_between_the_legs(direct, name):
    twist = [0.1, 0.2, -0.3, 0.1, 0.0, 0.2]
    most = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    rubbing, free = direct(), direct()
    rubbing.set(**{name: most}, initial_twist=twist)
    rubbing.start(brake=np.full(6, float(name == "brake_force")))
    free.set(initial_twist=twist)
    free.start(brake=np.zeros(6), force=-most * np.sign(rubbing.get("rate")))
    assert rubbing.get("acceleration") == pytest.approx(free.get("acceleration"), rel=1e-9)


def test_reflected_mass_may_differ_between_the_legs(direct):
    """The reflected mass m of a leg takes m ddl of its force."""
    force, mass = HOME_FORCE + np.arange(6) * 50.0, np.arange(6) * 100.0
    heavy, light = direct(), direct()
    heavy.set(reflected_mass=mass)
    heavy.start(force=force, brake=np.zeros(6))
    there = heavy.get("acceleration")
    heavy.step(1e-4)
    ddl = heavy.get("rate") / 1e-4
    light.start(force=force - mass * ddl, brake=np.zeros(6))
    assert np.abs(mass * ddl).max() > 10.0
    assert there == pytest.approx(light.get("acceleration"), rel=1e-3, abs=1e-3)


def test_a_falling_platform_comes_to_rest_on_its_end_stops(direct):
    plant = direct()
    plant.set(length_min=np.full(6, 1.5))
    plant.start(brake=np.zeros(6))
    lowest = 9.0
    for _ in range(3000):
        plant.step(1e-3)
        lowest = min(lowest, plant.get("length").min())
    # static: leg force divided by the stiffness of 2e7 N/m; the fall of some centimetres adds to it
    assert 1.5 - 0.01 < lowest < 1.5
    assert np.abs(plant.get("rate")).max() < 1e-6
    assert plant.get("length") == pytest.approx(np.full(6, 1.5), abs=5e-4)
    assert (plant.get("length") < 1.5).all()


@pytest.mark.parametrize("leg", range(6))
def test_end_stops_may_differ_between_the_legs(direct, leg):
    for name, end, force in (("length_min", 1.57, 0.0), ("length_max", 1.61, 8000.0)):
        plant, ends = direct(), np.full(6, 1.3 if name == "length_min" else 2.0)
        ends[leg] = end
        plant.set(**{name: ends})
        plant.start(force=np.full(6, force), brake=np.zeros(6))
        plant.step(1e-3, 150)
        beyond = (
            plant.get("length") < end - 0.002 if name == "length_min" else plant.get("length") > end + 0.002
        )
        assert not beyond[leg]
        assert beyond.sum() >= 3


def test_both_end_stops_act_if_a_leg_crosses_its_stroke_in_one_step(direct):
    plant, home = direct(), 1.592450434036
    plant.set(length_min=np.full(6, home - 1e-5), length_max=np.full(6, home + 1e-5))
    plant.set(coulomb_friction=np.full(6, 10.0), initial_twist=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    plant.start()
    plant.step(1e-3)
    assert np.abs(plant.get("length") - home).max() < 1e-3


def test_upper_end_stops_limit_the_legs_and_never_stick(direct):
    plant = direct()
    plant.set(length_max=np.full(6, 1.6))
    plant.start(force=np.full(6, 8000.0), brake=np.zeros(6))
    plant.step(1e-3, 2000)
    assert plant.get("length") == pytest.approx(np.full(6, 1.6), abs=1e-3)
    plant.set(force=np.zeros(6))
    plant.step(1e-3, 100)
    assert (plant.get("length") < 1.595).all()


def test_simulation_with_very_stiff_end_stops_is_stable(direct):
    plant = direct()
    plant.set(length_min=np.full(6, 1.5), stop_stiffness=1e12, stop_damping=1e3)
    plant.start(brake=np.zeros(6))
    plant.step(1e-3, 2000)
    assert plant.get("length") == pytest.approx(np.full(6, 1.5), abs=1e-6)


def test_first_order_lag_of_the_leg_force_is_exact_at_any_internal_step(direct):
    coarse, fine = direct(), direct()
    for plant, h in ((coarse, 1e-3), (fine, 1e-4)):
        plant.set(force_bandwidth=50.0, internal_step=h)
        plant.start(force=np.arange(1.0, 7.0))
        plant.step(1e-3, 5)
    want = np.arange(1.0, 7.0) * (1 - np.exp(-2 * np.pi * 50.0 * 5e-3))
    assert coarse.get("applied_force") == pytest.approx(want, rel=1e-13)
    assert fine.get("applied_force") == pytest.approx(want, rel=1e-13)


def test_integrator_of_the_platform_plant_converges_at_fourth_order(direct):
    ends = []
    for h in (8e-3, 4e-3, 5e-4):
        plant = direct()
        plant.set(internal_step=h, gravity=[0, 0, 9.81], initial_twist=[0.5, -0.4, 0.45, 0.5, -0.6, 0.8])
        plant.start(force=np.full(6, -HOME_FORCE), brake=np.zeros(6))
        plant.step(0.4)
        ends.append(plant.get("position"))
    first, second = (np.abs(e - ends[2]).max() for e in ends[:2])
    assert first / second == pytest.approx(16.0, rel=0.25)


def test_fmu_state_can_be_saved_restored_and_serialised(direct):
    plant = direct()
    plant.set(force_bandwidth=100.0)
    plant.start(force=np.full(6, 3000.0), brake=np.zeros(6))
    plant.step(1e-3, 20)
    state = plant.fmu.getFMUState()
    data = plant.fmu.serializeFMUState(state)
    plant.step(1e-3, 20)
    want = plant.get("position")
    plant.fmu.setFMUState(state)
    plant.time = 0.02
    plant.step(1e-3, 20)
    assert (plant.get("position") == want).all()
    other = direct()
    other.fmu.setFMUState(other.fmu.deserializeFMUState(data))
    other.time = 0.02
    other.step(1e-3, 20)
    assert (other.get("position") == want).all()


@pytest.mark.parametrize(
    ("t", "dt"), [(1e-3, 1.05e-4), (1e-3, 0.99999e-3), (1e-3, -1e-3), (1e-3, np.nan), (0.5, 1e-3)]
)
def test_fmu_step_of_invalid_length_or_start_time_is_refused_without_effect(direct, t, dt):
    plant = direct()
    plant.start(brake=np.zeros(6))
    plant.step(1e-3)
    before = plant.get("position")
    with pytest.raises(FMICallException):
        plant.fmu.doStep(t, dt)
    assert plant.messages
    assert (plant.get("position") == before).all()
    plant.fmu.doStep(1e-3, 1e-3)


def test_time_of_the_fmu_does_not_drift_over_many_steps(direct):
    plant = direct()
    plant.start()
    for k in range(20_000):
        plant.fmu.doStep(k * 1e-3, 1e-3)
    assert plant.get("time")[0] == pytest.approx(20.0, abs=4e-15)


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"mass": 0.0}, "mass"),
        ({"inertia": np.diag([1.0, 1.0, 5.0])}, "triangle"),
        ({"inertia": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, "symmetric"),
        ({"initial_rotation": np.diag([1.0, 1.0, -1.0])}, "reflection"),
        ({"initial_rotation": 2 * np.eye(3)}, "rotation"),
        ({"length_max": np.full(6, 1.2)}, "stroke"),
        ({"length_min": np.full(6, 3.0), "length_max": np.full(6, 2.0)}, "length_min"),
        ({"internal_step": 0.0}, "internal_step"),
        ({"cylinder_inertia": [40.0, 16.0]}, "axial"),
        ({"universal_joint_base_axes": np.zeros((6, 3))}, "axis"),
        ({"platform_joints": np.zeros((6, 3)), "initial_position": [2.0, 0.0, 0.0]}, "no length"),
    ],
)
def test_physically_impossible_fmu_parameters_are_refused(direct, values, word):
    plant = direct()
    plant.set(**values)
    with pytest.raises(FMICallException):
        plant.start()
    assert word in plant.messages[-1]


def test_reading_and_setting_fmu_variables_in_the_wrong_fmi_mode_is_refused(direct):
    plant = direct()
    for output in ("length", "potential_energy"):
        with pytest.raises(FMICallException):
            plant.get(output)
    plant.start()
    with pytest.raises(FMICallException):
        plant.set(mass=10.0)
    assert "fixed" in plant.messages[-1]
    with pytest.raises(FMICallException):
        plant.fmu.deserializeFMUState(b"x" * 5000)


LEAST_0 = (
    *(f"{part}mass" for part in ("", "cylinder_", "rod_", "reflected_")),
    *(f"{half}_{key}" for half in ("cylinder", "rod") for key in ("com", "inertia")),
    *("viscous_friction", "coulomb_friction", "force_bandwidth", "length_min", "length_max", "stop_damping"),
    *("brake_force", "brake"),
)


@pytest.mark.parametrize(
    ("name", "allowed", "refused"),
    [
        *((name, 0.0, -1e-9) for name in LEAST_0),
        *(("stop_stiffness", 1.0, 1.0 - 1e-9), ("brake", 1.0, 1.0 + 1e-9)),
        *(("force", 1e6, value) for value in (np.nan, np.inf, -np.inf)),
    ],
)
def test_fmu_value_out_of_range_is_refused_with_the_variable(direct, name, allowed, refused):
    plant = direct()
    plant.set(**{name: np.full(plant.size[name], allowed)})
    for element in range(plant.size[name]):
        values = np.full(plant.size[name], allowed)
        values[element] = refused
        with pytest.raises(FMICallException):
            plant.set(**{name: values})
        assert name in plant.messages[-1]
    assert plant.get(name).tolist() == [allowed] * plant.size[name]


def test_rod_forces_alone_accelerate_a_plant_without_friction_brake_and_reflected_mass_alike(direct):
    twist = [0.1, 0.2, -0.3, 0.1, 0.0, 0.2]
    lossy, free = direct(), direct()
    lossy.set(viscous_friction=np.arange(6) * 100.0, coulomb_friction=np.full(6, 40.0), initial_twist=twist)
    lossy.set(reflected_mass=np.arange(6) * 30.0)
    lossy.start(force=HOME_FORCE + np.arange(6) * 50.0, brake=np.array([0.0, 0, 0.001, 0, 0, 0]))
    free.set(initial_twist=twist)
    free.start(force=lossy.get("rod_force"), brake=np.zeros(6))
    assert lossy.get("acceleration") == pytest.approx(free.get("acceleration"), rel=1e-9)


def test_rods_carry_the_load_while_the_brakes_hold_and_the_drives_are_off(direct):
    plant = direct()
    plant.start()
    plant.step(0.01)
    assert plant.get("rod_force") == pytest.approx(HOME_FORCE, rel=1e-6)
    assert plant.get("applied_force") == pytest.approx(np.zeros(6))
