"""Bad input through the command line: exit code 2, one message that names the place, nothing written."""

import hashlib
import re
import subprocess
import sys
import zipfile

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from hil.app.configuration.configuration import load
from hil.cli import main
from plant_fmu.stewart.build import build
from tests.broad import broad

VIRTUAL = load("virtual").text
FIRST_TIME = re.compile(r"^compiling the mathematics, once: .*\n", re.MULTILINE)


def edited(*changes):
    text = VIRTUAL
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def contents(folder):
    """Every file below, with a digest of what is in it."""
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in folder.rglob("*")
        if p.is_file()
    }


@pytest.fixture
def refused(tmp_path, monkeypatch):
    """Run a command in an empty folder; it has to refuse, and to leave every file as it was and no new one."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        before = contents(tmp_path)
        result = CliRunner().invoke(main, [str(w) for w in words])
        assert isinstance(result.exception, SystemExit), result.exception
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert "Traceback" not in result.stderr
        assert contents(tmp_path) == before
        return FIRST_TIME.sub("", result.stderr)

    return run


@pytest.fixture
def bench(tmp_path):
    """Write the default configuration with changes; return its path."""

    def write(*changes):
        path = tmp_path / "bench.yaml"
        path.write_text(edited(*changes))
        return path

    return write


# -- configuration -------------------------------------------------------------------------------------------


def line_of(text):
    return next(n for n, line in enumerate(VIRTUAL.splitlines(), 1) if text in line)


KEYS = [
    ("unknown key", "priority: 80 ", "priorty: 80 ", "loop.priorty: unknown key, did you mean priority?"),
    (
        "wrong type",
        "wn_rad_s: 20\n",
        "wn_rad_s: fast\n",
        "controller.wn_rad_s: wrong type, allowed: a number greater than 0",
    ),
    ("missing unit", "  force_N: 25000", "  force: 25000", "limits.force: missing unit: the key is force_N"),
    ("NaN gain", "wn_rad_s: 20\n", "wn_rad_s: .nan\n", "controller.wn_rad_s: not a finite number"),
    (
        "five drives",
        "node_ids: [1, 2, 3, 4, 5, 6]",
        "node_ids: [1, 2, 3, 4, 5]",
        "drives.node_ids: wrong number of entries, allowed: a list of 6 whole numbers",
    ),
    (
        "watchdog",
        "watchdog_ms: 10 ",
        "watchdog_ms: 2.5 ",
        "drives.watchdog_ms: shorter than three periods, allowed: at least 3 (3 x 1 ms at loop.rate_Hz 1000), given: 2.5",
    ),
]


@pytest.mark.parametrize("command", ["sim", "run", "plant", "check"])
@pytest.mark.parametrize(("name", "old", "new", "message"), KEYS, ids=[k[0] for k in KEYS])
def test_a_wrong_key_or_value_is_named_with_file_line_and_column(
    refused, bench, command, name, old, new, message
):
    said = refused(command, bench((old, new)))
    assert re.match(rf"hil: \S*bench\.yaml:{line_of(old.strip())}:\d+: {re.escape(message)}", said)
    assert said.count("\n") == 1


def test_two_mistakes_are_told_at_once(refused, bench):
    said = refused("sim", bench(("priority: 80 ", "priorty: 80 "), ("wn_rad_s: 20\n", "wn_rad_s: .nan\n")))
    assert said.count("\n") == 2


@pytest.mark.parametrize("command", ["sim", "run", "plant", "check"])
def test_frames_that_do_not_fit_the_bus_are_refused_with_the_arithmetic(refused, bench, command):
    said = refused(command, bench(("layout: fd ", "layout: classic ")))
    # At worst 8 n + 47 + floor((34 + 8 n - 1) / 4) bit for n data bytes: 135 for 8, 75 for 2. Six feedbacks
    # and two commands for three legs each, and SYNC; 0.7 / 1155 us = 606 Hz.
    assert "8 x classic  8 byte: 135 bit = 135.0 us each, 1080.0 us" in said
    assert "1 x classic  2 byte: 75 bit = 75.0 us each, 75.0 us" in said
    assert "total 1155.0 us of a 1000.0 us period = 115.5 %" in said
    assert "606 Hz" in said
    assert re.search(r"bench\.yaml:\d+:\d+: bus: ", said)


def test_a_way_point_out_of_reach_is_refused_with_the_lengths(refused, bench):
    said = refused("sim", bench(("[0.25, 0.5, 0.75], rotation_vector_deg: [5, 10, 15]", "[0, 0, 3]")))
    # sqrt(1.2393^2 + 3^2) m for all legs, 1.2393^2 = 5 - 2 sqrt(3).
    assert "reference.points[1]: out of reach, allowed leg lengths: 0.77 to 2.18 m (soft ends)" in said
    assert "leg 0 3.2459" in said


@pytest.mark.parametrize("command", ["sim", "run", "plant", "check"])
def test_a_path_that_breaks_a_limit_on_its_way_is_refused_before_anything_starts(refused, bench, command):
    said = refused(command, bench(("speed_m_s: 2 ", "speed_m_s: 1 ")))
    found = re.search(r"reference: at t = 0\.(\d+) s: leg \d: rate above limits\.speed_m_s 1", said)
    assert found, said


@pytest.mark.parametrize("command", ["run", "plant"])
def test_the_ideal_layout_is_for_lockstep_only(refused, command):
    said = refused(command, "ideal")
    assert "bus.layout: `ideal`" in said
    assert "hil sim" in said


@pytest.mark.parametrize("command", ["run", "plant"])
def test_a_bus_inside_one_process_cannot_join_two(refused, bench, command):
    said = refused(command, bench(("interface: localcan ", "interface: virtual ")))
    assert "bus.interface: python-can's `virtual` bus lives inside one process" in said
    assert "localcan" in said


@pytest.mark.parametrize("command", ["sim", "plant"])
def test_without_a_plant_there_is_no_virtual_bench(refused, command):
    assert "plant: missing" in refused(command, "socketcan")


NO_YAML = {
    "a tab": b"bus:\n\tlayout: fd\n",
    "half a list": b"bus: [1, 2\n",
    "no text": bytes(range(128, 256)),
    "a control character": b"name: \x07\n",
    "nothing": b"",
    "a list": b"- 1\n- 2\n",
    "two documents": b"name: a\n---\nname: b\n",
}


@pytest.mark.parametrize("content", NO_YAML.values(), ids=NO_YAML)
def test_a_file_that_is_no_configuration_is_refused(refused, tmp_path, content):
    (tmp_path / "odd.yaml").write_bytes(content)
    assert refused("sim", "odd.yaml").startswith("hil: odd.yaml:1:") or content.startswith((b"bus", b"name"))


def test_a_folder_is_no_configuration(refused, tmp_path):
    (tmp_path / "folder").mkdir()
    assert refused("sim", "folder").startswith("hil: folder: cannot be read")


# -- FMU -----------------------------------------------------------------------------------------------------

MODEL = VIRTUAL[VIRTUAL.index("    type: stewart") : VIRTUAL.index("  drives:\n    encoder")]
FOREIGN = """\
    type: fmu
    path: robot.fmu
    isolation: in_process
    force: [force]
    length: [length]
    rate: [rate]
    brake: [brake]
    step_us: 1000
    parameters: {initial_position: [0, 0, 1]}
"""


@pytest.fixture
def robot(bench, tmp_path):
    """A bench whose plant is a foreign FMU: ours, copied, with changes to the map; leaves files out of it."""

    def write(*changes, without=None, fmu=True):
        if fmu:
            with (
                zipfile.ZipFile(build("3.0")) as source,
                zipfile.ZipFile(tmp_path / "robot.fmu", "w") as target,
            ):
                for name in source.namelist():
                    if without is None or not name.startswith(without):
                        target.writestr(name, source.read(name))
        model = FOREIGN
        for old, new in changes:
            assert model.count(old) == 1, old
            model = model.replace(old, new)
        return bench((MODEL, model))

    return write


def test_an_fmu_that_is_not_there(refused, robot):
    said = refused("sim", robot(fmu=False))
    assert re.search(r"bench\.yaml:\d+:\d+: plant\.model\.path: no such file, given: robot\.fmu", said)


@pytest.mark.parametrize("command", ["sim", "plant"])
def test_an_fmu_without_a_binary_for_this_machine(refused, robot, command):
    said = refused(command, robot(without="binaries/"))
    assert "robot.fmu: the FMU has no binary for this machine (binaries/" in said
    assert "it has binaries for none" in said


def test_an_fmu_variable_that_does_not_exist(refused, robot):
    said = refused("sim", robot(("length: [length]", "length: [lenght]")))
    assert "robot.fmu: the FMU has no variable 'lenght'" in said


def test_an_fmu_variable_in_another_unit(refused, robot):
    """kinetic_energy is in J; rates are in m/s."""
    said = refused("sim", robot(("rate: [rate]", "rate: [length]"), ("length: [length]", "length: [rate]")))
    assert "robot.fmu: variable 'rate'" in said
    assert "m/s" in said


def test_an_fmu_parameter_that_does_not_exist(refused, robot):
    said = refused("sim", robot(("initial_position:", "initial_pose:")))
    assert "the FMU has no variable 'initial_pose'" in said


def test_a_file_that_is_no_fmu(refused, robot, tmp_path):
    config = robot()
    (tmp_path / "robot.fmu").write_bytes(b"PK but no more")
    assert "robot.fmu" in refused("sim", config)


@pytest.mark.parametrize("command", ["sim", "plant"])
def test_a_plant_that_starts_at_other_lengths_than_the_platform(refused, robot, command):
    said = refused(command, robot(("[0, 0, 1]", "[0, 0, 1.1]")))
    # Book platform: q = sqrt(5 - 2 sqrt(3) + z^2), all legs; z = 1.1 in the plant and 1 in the configuration.
    assert "  plant:    1.6571 1.6571 1.6571 1.6571 1.6571 1.6571 m\n" in said
    assert "  platform: 1.5925 1.5925 1.5925 1.5925 1.5925 1.5925 m\n" in said
    assert "plant.initial_position_m" in said


def test_a_plant_that_starts_within_a_millimetre_is_taken(robot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = robot(("[0, 0, 1]", "[0, 0, 1.001]"))
    result = CliRunner().invoke(main, ["sim", str(config), "--duration", "0.2"])
    assert result.exit_code == 0, result.output


# -- logs and summaries --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    result = CliRunner().invoke(main, ["sim", "--duration", "1.0", "--log", str(path)])
    assert result.exit_code == 0, result.output
    return path


def consent(command: str) -> list[str]:
    return ["--arm"] if command == "run" else []


@pytest.mark.parametrize("command", ["sim", "run", "plant"])
def test_an_existing_log_is_not_overwritten(refused, tmp_path, command):
    (tmp_path / "precious.mcap").write_text("hours of work")
    said = refused(command, *consent(command), "--log", "precious.mcap")
    assert "precious.mcap: exists and is not overwritten" in said


@pytest.mark.parametrize("command", ["sim", "run", "plant"])
@pytest.mark.parametrize(
    ("folder", "why"), [("file", "is a file and no folder"), ("/proc/nowhere", "cannot be made")]
)
def test_a_log_where_no_folder_can_be_made(refused, tmp_path, command, folder, why):
    (tmp_path / "file").touch()
    said = refused(command, *consent(command), "--log", f"{folder}/run.mcap")
    assert f"{folder}: {why}" in said
    assert "; name another file with --log" in said


def test_a_log_with_a_name_too_long(refused):
    assert "name too long" in refused("sim", "--log", "x" * 300 + ".mcap").lower()


@pytest.mark.parametrize("command", ["sim", "run", "plant", "check"])
def test_a_summary_into_a_folder_that_is_not_there_is_refused_before_the_run(refused, command):
    said = refused(command, "--json", "nowhere/summary.json")
    assert "--json nowhere/summary.json: there is no folder nowhere" in said


def test_a_summary_does_not_overwrite_what_is_no_summary(refused, bench, log, tmp_path):
    config = bench()
    (tmp_path / "notes.json").write_text('{"mine": 1}')
    assert "is not a summary of hil" in refused("check", config, "--json", "notes.json")
    assert "another file of this command" in refused("check", config, "--json", config)
    assert "another file of this command" in refused("replay", log, "--json", log)
    assert "another file of this command" in refused("sim", "--log", "new", "--json", "./new")


def test_an_earlier_summary_is_replaced(bench, tmp_path):
    (tmp_path / "check.json").write_text('{"success": false}')
    result = CliRunner().invoke(main, ["check", str(bench()), "--json", str(tmp_path / "check.json")])
    assert result.exit_code == 0, result.output
    assert "figures" in (tmp_path / "check.json").read_text()


def test_a_replay_of_what_is_no_log(refused, tmp_path):
    (tmp_path / "notes.txt").write_text("no MCAP file at all")
    (tmp_path / "empty.mcap").touch()
    assert "notes.txt: not an MCAP file" in refused("replay", "notes.txt")
    assert "empty.mcap: the file is empty" in refused("replay", "empty.mcap")
    assert "nowhere.mcap: no such file" in refused("replay", "nowhere.mcap")


@pytest.mark.parametrize("share", [0.02, 0.5, 0.999])
def test_a_cut_log_is_refused_with_the_way_to_salvage_it(refused, log, tmp_path, share):
    data = log.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(share * len(data))])
    said = refused("replay", "cut.mcap")
    assert f"cut at {int(share * len(data))} bytes" in said
    assert "hil replay --salvage" in said


def test_salvage_recovers_a_cut_log_into_a_new_file_only(refused, log, tmp_path):
    data = log.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    (tmp_path / "there.mcap").write_text("precious")
    assert "there.mcap" in refused("replay", "cut.mcap", "--salvage", "there.mcap")
    result = CliRunner().invoke(main, ["replay", "cut.mcap", "--salvage", "whole.mcap"])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "cut.mcap").stat().st_size == len(data) // 2


def test_a_log_damaged_in_its_ticks_is_refused_with_the_place(refused, log, tmp_path):
    data = bytearray(log.read_bytes())
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    at = chunk.chunk_start_offset + chunk.chunk_length // 2
    data[at : at + 64] = bytes(64)
    (tmp_path / "damaged.mcap").write_bytes(data)
    assert f"damaged.mcap: damaged at byte {chunk.chunk_start_offset}" in refused("replay", "damaged.mcap")


@pytest.mark.parametrize("percent", range(1, 100, 7))
def test_no_damage_ends_in_a_traceback(log, tmp_path, percent):
    data = bytearray(log.read_bytes())
    at = percent * len(data) // 100
    data[at : at + 64] = bytes(64)
    (tmp_path / "damaged.mcap").write_bytes(data)
    result = CliRunner().invoke(main, ["replay", str(tmp_path / "damaged.mcap")])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception


# -- the program itself --------------------------------------------------------------------------------------

PROGRAM = [
    (["sim", "nowhere.yaml"], "nowhere.yaml: no such file"),
    (["sim", "--json", "nowhere/a.json"], "there is no folder nowhere"),
    (["simulate"], "No such command"),
    (["run", "ideal"], "`ideal`"),
    (["replay", "no.mcap"], "no.mcap: no such file"),
    (["sim", "--duration", "-1"], "-1"),
]


@pytest.mark.parametrize(("words", "message"), broad(PROGRAM, quick=3), ids=[" ".join(w) for w, _ in PROGRAM])
def test_the_installed_program_refuses_the_same_way(tmp_path, words, message):
    done = subprocess.run(
        [sys.executable, "-m", "hil.cli", *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert message in done.stderr
    assert ("Traceback" in done.stderr, done.stdout) == (False, "")
    assert list(tmp_path.rglob("*")) == []
