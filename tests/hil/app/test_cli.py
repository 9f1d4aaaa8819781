"""Command line: help, exit codes, summaries on the terminal and as JSON."""

import json
import re
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hil.app.configuration.text_file import shipped
from hil.app.output import brief, fold, headline
from hil.cli import main
from tests.hil.app.texts import edited


def commands(group, words=()):
    """Every command below a group, by the words that call it."""
    found: dict[tuple[str, ...], click.Command] = {}
    context = click.Context(group)
    for name in group.list_commands(context):
        command, here = group.get_command(context, name), (*words, name)
        found |= commands(command, here) if isinstance(command, click.Group) else {here: command}
    return found


COMMANDS = commands(main)


def hil(*words):
    return CliRunner().invoke(main, [str(w) for w in words])


# -- help ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_of_every_command_has_examples_and_guides(words):
    result = hil(*words, "--help")
    assert result.exit_code == 0
    text = result.output
    assert re.search(r"^  Examples:$", text, re.MULTILINE)
    guides = re.findall(r"docs/\S+?\.md", text.partition("Guide: ")[2])
    assert guides
    assert all((Path(__file__).parents[3] / guide).is_file() for guide in guides)
    assert "--json FILE" in text


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_example_in_the_help_parses(words):
    lines = re.findall(r"^    hil (.*?)(?: {2,}.*)?$", hil(*words, "--help").output, re.MULTILINE)
    assert 2 <= len(lines) <= 4
    for line in lines:
        given = shlex.split(line)
        assert tuple(given[: len(words)]) == words
        COMMANDS[words].make_context("hil", given[len(words) :])


def test_help_lists_commands_exit_codes_and_shipped_configurations():
    text = hil("--help").output
    assert re.findall(r"^    (\d+)  \w+", text, re.MULTILINE) == ["0", "1", "2", "130", "141"], "exit codes"
    listed = re.findall(r"^  (\w+) {2,}[A-Z]", text.partition("Commands:")[2], re.MULTILINE)
    assert listed[:5] == ["run", "plant", "sim", "replay", "check"]
    assert "fmu" in listed
    names = re.findall(r"[\w-]+", re.findall(r"shipped one:(.*?)\.\s+Logs", text, re.DOTALL)[0])
    assert sorted(set(names) - {"the", "default"}) == sorted(shipped())


def test_help_of_a_command_imports_no_numerical_or_bus_library():
    """Numpy, pydantic, numba and the bus take half a second to import; help works without them."""
    code = (
        "import sys; from hil.cli import main; main(['run', '--help'], standalone_mode=False); "
        "print('heavy:', [m for m in ('numpy', 'numba', 'pydantic', 'can', 'cantools', 'yaml', 'rich', 'fmpy')"
        " if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "heavy: []"


# -- exit codes and JSON -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim")
    result = hil("sim", "--duration", 1.5, "--log", folder / "run.mcap", "--json", folder / "run.json")
    return result, folder


def test_simulation_that_ends_parked_exits_with_0(simulated):
    result, folder = simulated
    assert result.exit_code == 0, result.output
    summary = json.loads((folder / "run.json").read_text())
    assert summary["success"] is True
    assert summary["final_mode"] == "PARKED"
    assert summary["log"] == str(folder / "run.mcap")
    assert summary["replay"]["exact"] is True
    tracking = summary["tracking"]
    assert result.stdout.splitlines()[0] == (
        f"Good: tracked {tracking['ticks'] / 1000:.3g} s, peak leg error "
        f"{tracking['peak_leg_error_mm']:.3g} mm, no force limited, replay exact"
    )
    assert len(result.stdout.splitlines()) <= 20
    for detail in ("skipped", "faults", "wall", "certificate", "plant"):
        assert detail not in result.stdout
    assert re.search(rf"^replay +{summary['ticks']} ticks, 0 differences$", result.stdout, re.MULTILINE)


def test_sim_with_verbose_prints_every_figure(tmp_path):
    result = hil("sim", "ideal", "--duration", 1.2, "--log", tmp_path / "a.mcap", "-v")
    for figure in ("wall", "skipped ticks", "faults", "largest V .*", "real time factor", "final mode"):
        assert re.search(rf"^ *{figure}  ", result.stdout, re.MULTILINE), figure


def test_headline_and_figures_of_a_run_show_limited_forces_late_feedback_and_losses(simulated):
    summary = json.loads((simulated[1] / "run.json").read_text())
    worse = summary | {"stale_ticks": 7, "dropped_ticks": 3, "rejected_frames": 4, "missing": ["SCHED_FIFO"]}
    worse["limited_ticks"] = {"FORCE_LIMIT": 0, "FORCE_STEP": 5}
    line = headline("sim", worse)
    assert "force limited in 5 ticks, late feedback in 7 ticks, 3 ticks not recorded" in line
    shown = brief(worse)
    assert {"stale_ticks", "dropped_ticks", "rejected_frames", "limited_ticks", "missing"} <= shown.keys()
    assert not {"stale_ticks", "dropped_ticks", "rejected_frames"} & brief(summary).keys()
    failed = summary | {"plant": {"success": False, "trouble": "the FMU failed"}}
    assert brief(failed)["plant"] == failed["plant"]


def test_replay_exits_with_0_and_does_not_change_the_log(simulated, tmp_path):
    log = simulated[1] / "run.mcap"
    before = log.read_bytes()
    result = hil("replay", log, "--json", tmp_path / "replay.json")
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "replay.json").read_text())
    assert summary["success"] is True
    assert summary["different_ticks"] == 0
    assert re.search(rf"^replay +{summary['ticks']} ticks, 0 differences$", result.stdout, re.MULTILINE)
    assert log.read_bytes() == before


def test_sim_that_ends_in_a_fault_exits_with_1_and_lists_the_fault_in_its_summary(tmp_path):
    tight = edited(
        ("following_error_m: 0.01", "following_error_m: 1e-6"),
        ("following_error_s: 0.01 ", "following_error_s: 0 "),
    )
    (tmp_path / "tight.yaml").write_text(tight)
    result = hil("sim", tmp_path / "tight.yaml", "--log", tmp_path / "a.mcap", "--json", tmp_path / "a.json")
    assert result.exit_code == 1, result.output
    summary = json.loads((tmp_path / "a.json").read_text())
    assert summary["success"] is False
    assert summary["faults"] == ["FOLLOWING"]
    assert result.stdout.splitlines()[0] == "sim: failed"
    assert re.search(r"^faults +FOLLOWING$", result.stdout, re.MULTILINE)
    story = summary["story"]
    assert story["findings"]
    for finding in story["findings"]:
        assert finding["value"] > finding["limit"] == pytest.approx(1e-6)
        assert f"leg {finding['leg']} is " in result.stderr
    assert all(line in result.stderr for line in story["lines"])
    assert "docs/guides/glossary-of-faults.md#fault-following" in result.stderr
    again = hil("replay", tmp_path / "a.mcap", "--json", tmp_path / "b.json")
    assert again.exit_code == 0, again.output
    assert json.loads((tmp_path / "b.json").read_text())["story"] == story


def test_check_prints_figures_and_exits_with_0(tmp_path):
    result = hil("check", "virtual", "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    assert "total 568.2 us of a 1000.0 us period = 56.8 %" in result.stdout
    summary = json.loads((tmp_path / "check.json").read_text())
    assert summary["success"] is True
    assert summary["figures"]["bus"]["total_us"] == pytest.approx(568.2)


def test_misspelt_command_is_refused_with_the_nearest_name():
    result = hil("chekc")
    assert result.exit_code == 2
    assert "No such command 'chekc'. Did you mean 'check'?" in result.stderr
    assert "Did you mean" not in hil("qqqq").stderr


@pytest.mark.parametrize("name", ["virtual", "lab", "desktop"])
def test_check_begins_with_its_warnings_and_prints_at_most_40_lines_of_figures(name):
    shown, whole = hil("check", name).stdout.splitlines(), hil("check", name, "-v").stdout.splitlines()
    count = sum(line.startswith("  warning: ") for line in shown)
    assert shown[0] == f"{name}: valid, {count or 'no'} warning{'s' * (count != 1)}"
    figures = shown.index("robot at home")
    assert all("warning: " not in line for line in shown[figures:])
    assert sum(line.startswith("  ") and line[6] != " " for line in shown[figures:]) <= 40
    further = " ".join(line.strip() for line in shown).partition("further figures, with -v: ")[2]
    assert all(title in whole for title in further.split("; ")), further


def test_fold_breaks_lines_after_phrases_and_keeps_long_paths_whole():
    text = "leg lengths 1.5925 1.5925 m (stroke 0.75 to 2.2); next, and " + "/a/long/path" * 4
    assert fold(text, 40) == [
        "leg lengths 1.5925 1.5925 m",
        "(stroke 0.75 to 2.2); next,",
        "and",
        "/a/long/path" * 4,
    ]
    assert fold("short", 40) == ["short"]
    assert "".join(fold("word " * 50, 33)).replace(" ", "") == "word" * 50


def test_check_reports_all_problems_and_exits_with_2(tmp_path):
    (tmp_path / "two.yaml").write_text(
        edited(("silence: brake ", "silence: pray "), ("priority: 80", "priorty: 80"))
    )
    result = hil("check", tmp_path / "two.yaml", "--json", tmp_path / "check.json")
    assert result.exit_code == 2
    summary = json.loads((tmp_path / "check.json").read_text())
    assert summary["success"] is False
    assert len(summary["problems"]) == 2
    for problem in summary["problems"]:
        assert problem in result.stderr


def test_fmu_build_writes_an_fmi_2_and_an_fmi_3_fmu_into_a_new_folder(tmp_path):
    result = hil("fmu", "build", "--output", tmp_path / "new" / "fmus", "--json", tmp_path / "fmu.json")
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "fmu.json").read_text())
    for version in "23":
        path = tmp_path / "new" / "fmus" / f"stewart-fmi{version}.fmu"
        assert summary[f"fmi_{version}"] == str(path)
        assert "modelDescription.xml" in zipfile.ZipFile(path).namelist()
