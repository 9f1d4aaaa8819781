"""`hil bus` in lockstep and its refusals."""

import zipfile

import fmpy
import pytest
from click.testing import CliRunner

from hil.cli.bus import command
from hil.cli.fmu import fmu_show_command
from tests.network.can_nodes import build_node, description, terminals


def test_lockstep_writes_all_frames_with_their_ends(tmp_path):
    fmus = [str(build_node(tmp_path, i, OFFSET_NS=1_000_000)) for i in (0x100, 0x200)]
    log = tmp_path / "frames.log"
    done = CliRunner().invoke(command, [*fmus, "--duration", "0.0025", "--log", str(log)])
    assert done.exit_code == 0, done.output
    lines = [line.split("#")[0] for line in log.read_text().splitlines()]
    assert lines == [
        "(0.001270) fmu 100",
        "(0.001540) fmu 200",
        "(0.002270) fmu 100",
    ]


def test_fmu_show_leads_from_a_can_fmu_to_hil_bus(tmp_path):
    done = CliRunner().invoke(fmu_show_command, [str(build_node(tmp_path, 0x100))])
    assert "`hil bus`" in done.output


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--log", "none/frames.log"], "--log none/frames.log"),
        (["--classic"], "--classic"),
        (["--interface", "localcan", "--error-every", "3"], "--error-every"),
    ],
)
def test_option_that_cannot_act_is_refused_by_its_name(options, word):
    done = CliRunner().invoke(command, ["none.fmu", *options])
    assert done.exit_code != 0
    assert word in done.output + str(done.exception)


@pytest.mark.parametrize(
    ("xml", "icons", "word"),
    [
        (description(True), None, "terminalsAndIcons"),
        (description(True), terminals(), "terminals: none"),
        (description(True), terminals("A", "B"), "A, B"),
        (description(True), "<broken", "cannot be read"),
        (description(True).replace("hasEventMode", "other"), terminals("A"), "hasEventMode"),
        (description(True).replace('"countdown"', '"constant"'), terminals("A"), "Tx_Clock"),
        (description(True).replace("ls-bus.can", "ls-bus.lin"), terminals("A"), "terminals: none"),
        (description(True).replace('valueReference="3"', 'valueReference="x"'), terminals("A"), "'x'"),
    ],
)
def test_an_fmu_without_a_usable_can_terminal_is_refused_with_the_reason(tmp_path, xml, icons, word):
    path = tmp_path / "node.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"binaries/{fmpy.platform_tuple}/node{fmpy.sharedLibraryExtension}", "")
        archive.writestr("modelDescription.xml", xml)
        if icons is not None:
            archive.writestr("terminalsAndIcons/terminalsAndIcons.xml", icons)
    done = CliRunner().invoke(command, [str(path)])
    assert isinstance(done.exception, Exception)
    assert word in str(done.exception)
