"""Identity of a campaign, and the files that its rows name."""

from pathlib import Path

import pytest

from drivers.errors import ConfigurationError, LogError
from hil.app.configuration.configuration import load
from hil.study.campaign.command import run_campaign
from hil.study.campaign.plan import identity, read_plan
from hil.study.campaign.row import row_configuration, run_row
from hil.study.campaign.store import stored_rows
from tests.drivers.cia402_sheet import sheet
from tests.hil.study.campaign.campaigns import SMALL, written


def test_campaign_identity_depends_on_rows_and_configuration_only(tmp_path):
    def parts(text, name="c.yaml"):
        return identity(read_plan(written(tmp_path, text, name)))

    own = parts(SMALL)
    assert parts("# a remark\n" + SMALL, "other.yaml") == own
    seed = parts(SMALL.replace("seed: 3", "seed: 4"))
    assert {name for name in own if own[name] != seed[name]} == {"campaign", "values of the rows"}
    text = load("virtual").text.replace("wn_rad_s: 20", "wn_rad_s: 21")
    (tmp_path / "changed.yaml").write_text(text)
    other = parts(SMALL.replace("configuration: virtual", "configuration: changed.yaml"))
    assert {name for name in own if own[name] != other[name]} == {"campaign", "configuration"}


def path_csv(end_m):
    """A path along z as CSV, which ends at this height."""
    rows = [f"{t},0,0,{1 + (end_m - 1) * (t > 1)},0,0,0" for t in range(4)]
    return "\n".join(("t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", *rows))


SAMPLED = SMALL + "changes: {reference: {type: sampled, path: path.csv}}\n"


def test_content_of_a_referenced_file_is_part_of_the_campaign_identity(tmp_path):
    """Next to the configuration, or next to the campaign if the configuration is a shipped one."""
    (tmp_path / "own.yaml").write_text(load("virtual").text)
    for text in (SAMPLED, SAMPLED.replace("configuration: virtual", "configuration: own.yaml")):
        found = []
        for folder, end_m in (("a", 1.001), ("a", 1.0011), ("b", 1.0011)):
            (tmp_path / folder).mkdir(exist_ok=True)
            (tmp_path / folder / "own.yaml").write_text(load("virtual").text)
            (tmp_path / folder / "path.csv").write_text(path_csv(end_m))
            found.append(identity(read_plan(written(tmp_path / folder, text))))
        one, other, elsewhere = found
        assert {name for name in one if one[name] != other[name]} == {"file path.csv"}
        assert other == elsewhere


def test_file_next_to_the_configuration_takes_precedence_over_one_next_to_the_campaign(tmp_path):
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "own.yaml").write_text(load("virtual").text)
    (tmp_path / "path.csv").write_text(path_csv(1.001))
    text = SAMPLED.replace("configuration: virtual", "configuration: robot/own.yaml")
    found = row_configuration(read_plan(written(tmp_path, text)).job(0)).reference
    assert found.model_dump()["path"] == str(tmp_path / "path.csv")
    (tmp_path / "robot" / "path.csv").write_text(path_csv(1.0011))
    found = row_configuration(read_plan(written(tmp_path, text)).job(0)).reference
    assert found.model_dump()["path"] == str(tmp_path / "robot" / "path.csv")


def test_rows_with_a_file_that_changed_during_the_campaign_are_not_stored(tmp_path):
    """Whether the file is restored or read again, its row never joins the rows of the earlier version."""
    file = tmp_path / "path.csv"
    file.write_text(path_csv(1.001))
    plan, out = read_plan(written(tmp_path, SAMPLED)), tmp_path / "results"

    def change(done, _):
        if done == 2:
            file.write_text(path_csv(1.002))

    with pytest.raises(
        ConfigurationError, match=r"path\.csv: has changed since .* Restore the file and repeat"
    ):
        run_campaign(plan, out, jobs=1, progress=change)
    assert sorted(stored_rows(out, identity(plan))) == [0, 1]
    assert not (out / "table.parquet").exists()
    with pytest.raises(LogError, match=r"these parts differ: file path\.csv"):
        run_campaign(read_plan(plan.path), out, jobs=1)
    file.write_text(path_csv(1.001))
    assert run_campaign(read_plan(plan.path), out, jobs=1)["rows_kept"] == 2


def test_a_row_whose_file_was_deleted_is_refused(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(path_csv(1.001))
    plan = read_plan(written(tmp_path, SAMPLED))
    file.unlink()
    with pytest.raises(ConfigurationError, match=r"path\.csv: has changed since"):
        run_row(plan.job(0))


def test_files_of_a_campaign_are_not_searched_in_the_working_directory(tmp_path, monkeypatch):
    """`hil check` and `hil sim` do not search there either."""
    for name in ("here", "campaign"):
        (tmp_path / name).mkdir()
    (tmp_path / "here" / "path.csv").write_text(path_csv(1.001))
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(ConfigurationError, match=r"path\.csv"):
        read_plan(written(tmp_path / "campaign", SAMPLED))


CHANGED = """
kind: campaign
configuration: ../robot/own.yaml
duration_s: 0.05
changes: {drives: {options: {eds: drive.eds}}}
grid: {force_N: {key: limits.force_N, values: [9000, 9001]}}
"""
SWEPT = CHANGED.partition("changes:")[0] + "grid: {sheet: {key: drives.options.eds, values: [drive.eds]}}\n"
FOLDERS = ("here", "robot", "campaign")


@pytest.mark.parametrize("text", [CHANGED, SWEPT], ids=["changed", "swept"])
@pytest.mark.parametrize("first", range(3), ids=FOLDERS)
def test_campaign_row_reads_its_drive_eds_in_any_working_directory(tmp_path, monkeypatch, text, first):
    for name in ("elsewhere", *FOLDERS):
        (tmp_path / name).mkdir()
        if name not in FOLDERS[:first]:
            (tmp_path / name / "drive.eds").write_text(sheet(), encoding="ascii")
    (tmp_path / "elsewhere" / "drive.eds").write_text(sheet(0x605E), encoding="ascii")
    (tmp_path / "robot" / "own.yaml").write_text(load("virtual-cia402").text)
    monkeypatch.chdir(tmp_path / "here")
    plan = read_plan(written(tmp_path / "campaign", text))
    assert [name for name in identity(plan) if name.startswith("file")] == ["file drive.eds"]
    monkeypatch.chdir(tmp_path / "elsewhere")  # as a worker of a cluster; that sheet would be refused
    found = Path(str(row_configuration(plan.job(0)).drives.options["eds"]))
    assert found.is_absolute()
    assert found.samefile(tmp_path / FOLDERS[first] / "drive.eds")
