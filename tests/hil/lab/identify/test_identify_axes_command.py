"""What `hil identify` refuses, which part of a log it takes, and the files between commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from drivers.errors import ConfigurationError, IdentificationError, LogError
from drivers.signals import Mode
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.section_file import check_section_path, read_section, write_section
from hil.cli import main
from hil.config.axis_model import AxisModel
from hil.config.reference import MultisineAxis, MultisineReference, Sinusoid, SinusoidReference
from hil.config.values import Pose
from hil.lab.identify.axes import excited_axes
from hil.lab.identify.estimators.excitation import axis_excitation
from hil.lab.identify.estimators.response import AxisSignals
from hil.lab.identify.linearised import linearised_law, repeating, settled, signals_of
from hil.robot.kinematics import jacobian


def identify(*arguments):
    return CliRunner(env={"COLUMNS": "120"}).invoke(main, ["identify", *map(str, arguments)])


def edited(old, new):
    text = load("virtual").text
    assert text.count(old) == 1, old
    return loads(text.replace(old, new), "my.yaml", Path())


# -- refusals ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["virtual", "--duration", "5"], "allowed: at least 4, 10.5 s with fading"),
        (["virtual", "--force", "1e5"], "limits.force_step_N"),
        (["bench"], "demands no acceleration"),
        (["virtual", "-o", "/nowhere/axes.yaml"], "no folder /nowhere"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_anything_runs(arguments, said, tmp_path):
    result = identify(*arguments, "--log", tmp_path / "a.mcap")
    assert result.exit_code == 2
    assert said in result.stderr
    assert not (tmp_path / "a.mcap").exists()


def test_a_file_that_is_no_axis_model_is_not_overwritten(tmp_path):
    mine = tmp_path / "axes.yaml"
    mine.write_text("name: mine\n")
    result = identify("virtual", "-o", mine, "--log", tmp_path / "a.mcap")
    assert result.exit_code == 2
    assert "is not a file of kind axis-model and is not overwritten" in result.stderr
    assert mine.read_text() == "name: mine\n"


def test_an_axis_model_whose_picture_would_take_its_place_is_refused_before_anything_runs(tmp_path):
    result = identify("virtual", "-o", tmp_path / "axes.png", "--log", tmp_path / "a.mcap")
    assert result.exit_code == 2
    assert f"--model {tmp_path / 'axes.png'}: its picture takes a name in .png" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_designed_controller_is_identified_in_the_axes_of_its_file(tmp_path):
    gains = "A: []\nB: []\nC: [[]]\nD: [[400.0, 40.0]]\nanti_windup: []\ndesign: {}\n"
    kind = "kind: linear-controller\nmethod: hinf\naxes: pose\nrate_Hz: 1000\ninputs: [error, rate_error]\n"
    (tmp_path / "pd.yaml").write_text(kind + gains)
    text = load("virtual").text
    first, last = text.index("\ncontroller:") + 1, text.index("\nengage:") + 1
    law = "controller: {law: state_space, controller_file: pd.yaml}\n\n"
    c = loads(text[:first] + law + text[last:], "my.yaml", tmp_path)
    assert linearised_law(c).space == "pose"


def rows_of(mode, q):
    rows = np.zeros(len(q), ROW)
    rows["mode"], rows["q"], rows["tick"] = mode, q, np.arange(len(q))
    rows["p"], rows["R"] = (0.0, 0.0, 1.0), np.eye(3)
    return rows


def test_a_log_that_tracks_nothing_is_refused():
    law = linearised_law(load("virtual"))
    with pytest.raises(LogError, match="no tick that tracks a reference"):
        signals_of(rows_of(Mode.RELEASING, np.ones((9, 6))), law, 1000.0)
    with pytest.raises(LogError, match="no tick that tracks a reference"):
        signals_of(np.zeros(0, ROW), law, 1000.0)


def test_a_log_of_a_held_platform_is_refused_for_its_motion():
    q = 1.4 + 1e-6 * np.random.default_rng(1).integers(0, 2, (5000, 6))
    with pytest.raises(
        IdentificationError, match=r"no leg moves by more than 0.001 mm, allowed: at least 0.1"
    ):
        signals_of(rows_of(Mode.TRACKING, q), linearised_law(load("virtual")), 1000.0)


# -- the excitation ------------------------------------------------------------------------------------------


def test_each_leg_moves_alone_at_its_own_lines():
    """To first order: the pose that a line moves, through the Jacobian, is one leg's."""
    made = excited_axes(load("virtual"), None, None).configuration
    model = linearised_law(made).model
    J = jacobian(model.platform, np.array(made.platform.home.position_m), np.eye(3))
    words = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
    lines: dict[float, np.ndarray] = {}
    assert isinstance(made.reference, SinusoidReference)
    for c in made.reference.components:
        scale = np.pi / 180 if c.axis.endswith("_deg") else 1.0
        lines.setdefault(c.frequency_Hz, np.zeros(6))[words.index(c.axis)] = scale * c.amplitude
    own = {f: J @ moved for f, moved in lines.items() if f >= 1.0}
    assert len(own) == 72
    counted = np.zeros(6, int)
    for legs in own.values():
        leg = int(np.argmax(np.abs(legs)))
        counted[leg] += 1
        assert np.delete(np.abs(legs), leg).max() < 1e-4 * abs(legs[leg])
    assert (counted == 12).all()
    assert min(own) == 1.0
    assert max(own) == 100.0


@pytest.mark.parametrize("space", ["joint", "pose"])
def test_about_a_pose_that_is_turned_each_line_moves_its_own_axis_alone(space):
    """By differences: legs, or shifts and turns about the axes of the base, of a small way along each line."""
    model = linearised_law(load("virtual")).model
    home = Pose(position_m=(0.05, -0.1, 1.05), rotation_vector_deg=(14.0, -11.0, 17.0))
    made = axis_excitation(model, home, space, 1000.0, 300.0, None)
    words = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
    lines: dict[float, np.ndarray] = {}
    for c in made.components:
        lines.setdefault(c.frequency_Hz, np.zeros(6))[words.index(c.axis)] = c.amplitude
    at = np.array([*home.position_m, *home.rotation_vector_deg])

    def axes(pose):
        R = Rotation.from_rotvec(np.deg2rad(pose[3:]))
        turn = R * Rotation.from_rotvec(np.deg2rad(at[3:])).inv()
        if space == "pose":
            return np.concatenate([pose[:3], turn.as_rotvec()])
        joints = pose[:3] + R.apply(np.array(model.platform.platform_joints))
        return np.linalg.norm(joints - model.platform.base_joints, axis=1)

    counted = np.zeros(6, int)
    for f, way in lines.items():
        small = 1e-4 * way / np.abs(way).max()
        moved = np.abs(axes(at + small) - axes(at - small))
        if f >= 1.0:
            axis = int(np.argmax(moved))
            counted[axis] += 1
            assert np.delete(moved, axis).max() < 1e-4 * moved[axis]
        elif space == "joint":
            assert np.ptp(moved) < 1e-4 * moved.max(), "underneath all legs extend at one speed"
    assert (counted == 12).all()
    assert len(lines) == 73


def test_a_slow_loop_gets_longer_periods_for_as_many_lines():
    made = excited_axes(edited("rate_Hz: 1000\n", "rate_Hz: 500\n"), None, None).configuration
    lines = repeating(made.reference, 500.0)
    assert lines is not None
    assert len(lines.harmonics) == 72
    assert lines.harmonics.max() * 500.0 / lines.length == 50.0
    assert lines.length == 4 * 500


# -- which part of a log -------------------------------------------------------------------------------------


def sinusoids(*frequencies, duration_s=10.0):
    components = [Sinusoid(axis="z_m", amplitude=1e-3, frequency_Hz=f) for f in frequencies]
    return SinusoidReference(
        type="sinusoids", centre=Pose(position_m=(0, 0, 1)), components=components, ramp_s=1.0,
        duration_s=duration_s,
    )  # fmt: skip


def lines_of(reference, rate_Hz):
    lines = repeating(reference, rate_Hz)
    assert lines is not None
    return lines.length, lines.harmonics.tolist()


def test_the_period_is_the_one_in_which_all_lines_repeat():
    assert lines_of(sinusoids(1.5, 2.5, 1e-4), 1000.0) == (2000, [3, 5])
    assert lines_of(sinusoids(1.5, 490.0), 1000.0) == (2000, [3]), "490 Hz is too near to half the rate"


def test_what_never_repeats_is_taken_in_segments():
    assert repeating(sinusoids(1.0, 2**0.5), 1000.0) is None
    assert repeating(sinusoids(1.0, 1.01), 1000.0) is None, "a period of 100 s"
    assert repeating(load("virtual").reference, 1000.0) is None


def test_a_multisine_repeats_in_its_own_period():
    axis = MultisineAxis(axis="z_m", band_Hz=(1.0, 4.0), lines=4, amplitude=1e-3)
    reference = MultisineReference(type="multisine", axes=[axis], period_s=1.0, periods=5)
    assert lines_of(reference, 500.0) == (500, [1, 2, 3, 4])


def counted(t, reference, length, good=True):
    still = np.zeros((len(t), 6))
    signals = AxisSignals(1e-3, still, still, still, np.full(len(t), good) if np.isscalar(good) else good)
    return settled(signals, t, reference, length)


def test_the_last_whole_periods_between_the_ramps_count():
    t = 1e-3 * np.arange(10000, dtype=np.float64)
    mask = counted(t, sinusoids(0.5 / 1.5), 3000)
    assert np.flatnonzero(mask)[[0, -1]].tolist() == [3000, 8999]
    assert mask.sum() == 6000


def test_a_run_that_was_stopped_counts_as_far_as_it_went():
    t = np.where(np.arange(8000) < 5500, np.arange(8000) * 1e-3, np.nan)
    mask = counted(t, sinusoids(1.0), 1000)
    assert mask.sum() == 4000
    assert np.flatnonzero(mask)[-1] <= 5500


@pytest.mark.parametrize("speed", [0.5, 0.9])
def test_no_tick_counts_where_the_reference_ran_at_less_than_full_speed(speed):
    """Its lines lie lower by that, between those that are looked for."""
    mask = counted(speed * 1e-3 * np.arange(10000), sinusoids(1.0), 1000)
    assert mask.sum() <= 1, "before the first one nothing is known"


def test_a_stretch_at_less_than_full_speed_does_not_count_and_what_is_beside_it_does():
    """Slowly from tick 2500 on, at rest from 3000 on, and as the clock again from 4500 on."""
    speed = np.ones(10000)
    speed[2500:3000], speed[3000:4500] = 0.5, 0.0
    t = 1e-3 * np.concatenate([[0.0], np.cumsum(speed[:-1])])
    mask = counted(t, sinusoids(1.0, duration_s=9.0), 1)
    expected = (t >= 1.0 - 1e-9) & (t < 8.0 - 1e-9)
    expected[2501:4501] = False
    assert np.flatnonzero(mask).tolist() == np.flatnonzero(expected).tolist()


def test_ticks_that_the_log_lacks_take_no_other_with_them():
    t = 1e-3 * np.arange(10000)
    good = np.ones(10000, bool)
    good[[4000, 6001, 6002]] = False
    held = np.maximum.accumulate(np.where(good, t, 0.0))
    assert np.flatnonzero(~counted(held, sinusoids(1.0), 1, good)[1000:9000]).tolist() == [3000, 5001, 5002]


# -- files between commands ----------------------------------------------------------------------------------


def axis_model():
    measured = {
        "frequency_Hz": [1.0, 2.0],
        "magnitude": [0.025, 0.006],
        "phase_deg": [-180.0, -181.0],
        "coherence": [1.0, 0.99],
        "magnitude_std": [1e-5, 1e-6],
        "phase_std_deg": [0.1, 0.2],
    }
    return AxisModel.model_validate(
        {
            "kind": "axis-model",
            "source": "a.mcap",
            "axes": "joint",
            "rate_Hz": 1000.0,
            "nominal": {"gain": [1.0] * 6, "transport_ms": 0.5, "lag_ms": 0.796},
            "uncertainty": {"frequency_Hz": [1.0, 2.0], "bound": [0.01, 0.02]},
            "measured": [measured] * 6,
        }
    )


def test_an_axis_model_is_read_as_it_was_written(tmp_path):
    file = tmp_path / "axes.yaml"
    write_section(file, axis_model(), "Made by a test.")
    assert file.read_text().startswith("# Made by a test.\nkind: axis-model\n")
    assert read_section(file, AxisModel)[0] == axis_model()
    check_section_path("-o", file, AxisModel)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "kind: axis-model",
            "kind: linear-controller",
            r"axes.yaml: is of kind 'linear-controller'.*allowed: .*`kind: axis-model`",
        ),
        ("lag_ms: 0.796", "lag_ms: -1", r"axes.yaml:\d+:\d+: nominal.lag_ms"),
        ("axes: joint", "axes: legs", r"axes.yaml:\d+:\d+: axes: .*joint, pose"),
        ("rate_Hz: 1000.0", "rate: 1000.0", "rate_Hz"),
        ("bound: [0.01, 0.02]", "bound: [0.01]", "allowed"),
        ("kind: axis-model", "kind: [", r"axes.yaml:\d+"),
    ],
)
def test_a_wrong_axis_model_is_refused_with_place_and_what_is_allowed(tmp_path, old, new, said):
    file = tmp_path / "axes.yaml"
    write_section(file, axis_model(), "Made by a test.")
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))
    with pytest.raises(ConfigurationError, match=said):
        read_section(file, AxisModel)


def test_a_missing_axis_model_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="no such file"):
        read_section(tmp_path / "nothing.yaml", AxisModel)
