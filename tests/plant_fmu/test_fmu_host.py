"""Hosting: agreement with fmpy's own simulation, and invalid FMUs."""

import zipfile

import fmpy
import numpy as np
import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.host import FmuHost
from plant_fmu.stewart.build import build

FORCE = np.array([3700.0, 3600.0, 3650.0, 3500.0, 3620.0, 3610.0])
VERSIONS = ["2.0", "3.0"]
XML = "modelDescription.xml"


def spec(path, **changes):
    names = {"force": ("force",), "length": ("length",), "rate": ("rate",), "brake": ("brake",)}
    return FmuSpec.model_construct(**{"path": str(path), **names, **changes})


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """Folder into which FMUs are unpacked."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_simulates_the_own_fmu_with_the_same_motion_within_1e_12(version):
    if version == "2.0":
        start = {f"force[{i + 1}]": FORCE[i] for i in range(6)} | {f"brake[{i + 1}]": 0.0 for i in range(6)}
        wanted = [f"length[{i}]" for i in range(1, 7)] + [f"rate[{i}]" for i in range(1, 7)]
    else:
        start = {"force": FORCE.tolist(), "brake": [0.0] * 6}
        wanted = ["length", "rate"]
    start["force_bandwidth"] = 200.0
    result = fmpy.simulate_fmu(
        str(build(version)), stop_time=0.3, output_interval=1e-3, start_values=start, output=wanted
    )
    rows = np.array([np.concatenate([np.ravel(x) for x in list(r)[1:]]) for r in result])
    host = FmuHost(spec(build(version), parameters={"force_bandwidth": 200.0}))
    ours = [np.concatenate(host.reset())]
    for _ in range(300):
        ours.append(np.concatenate(host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)))
    host.close()
    assert rows.shape == (301, 12)
    assert np.abs(rows - np.array(ours)).max() <= 1e-12
    assert np.abs(rows[-1] - rows[0]).max() > 1e-3


def test_closing_an_fmu_removes_its_unpacked_files_and_may_be_repeated(tmp_path, temporary):
    """The files stay while the FMU may read them."""
    host = FmuHost(spec(rewritten(build("3.0"), tmp_path / "reads.fmu", extra=[("resources/a", b"x")])))
    (folder,) = temporary.iterdir()
    assert (folder / XML).is_file()
    assert (folder / "resources/a").read_bytes() == b"x"
    host.close()
    host.close()
    assert not folder.exists()
    with pytest.raises(PlantError, match="closed"):
        host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)


def test_own_fmu_has_no_unpacked_files_once_it_is_loaded(temporary):
    """A process that is killed leaves nothing behind."""
    host = FmuHost(spec(build("3.0"), truth=("position", "rotation", "twist", "applied_force")))
    assert list(temporary.iterdir()) == []
    moved = [host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)[0] for _ in range(2)]
    host.reset()
    again = host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)[0]
    host.close()
    assert not np.array_equal(moved[0], moved[1])
    np.testing.assert_array_equal(again, moved[0])


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"weight": 1.0}, "no variable 'weight'"),
        ({"mass": "heavy"}, "not a valid value"),
        ({"gravity": [0.0, 1.0]}, "3 elements but 2"),
        ({"length": [0.0] * 6}, "only parameters"),
        ({"leg_spin": "sometimes"}, "not a valid value"),
        ({"mass": -1.0}, "refused parameter 'mass'.*outside"),
        ({"length_max": [1.5] * 6}, "stroke"),
    ],
)
@pytest.mark.parametrize("version", VERSIONS)
def test_invalid_fmu_parameter_is_refused(version, parameters, word):
    with pytest.raises(PlantError, match=word):
        FmuHost(spec(build(version), parameters=parameters))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"force": ("thrust",)}, "no variable 'thrust'"),
        ({"force": ("length",)}, "causality output; input is needed"),
        ({"length": ("force",)}, "causality input; output is needed"),
        ({"length": ("rate",)}, "'rate.*' is in 'm/s'; m is needed"),
        ({"force": ("brake",)}, "declares no unit"),
        ({"brake": ("force", "wrench")}, "12 values; 6 are needed"),
    ],
)
@pytest.mark.parametrize("version", VERSIONS)
def test_mapping_of_a_plant_signal_to_an_unsuitable_fmu_variable_is_refused(version, changes, word):
    with pytest.raises(PlantError, match=word):
        FmuHost(spec(build(version), **changes))


def rewritten(path, out, change=lambda name, data: data, extra=()):
    """Copy an FMU; `change` returns the new content of a member, None to drop it."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for member in source.infolist():
            data = change(member.filename, source.read(member))
            if data is not None:
                target.writestr(member.filename, data)
        for info, data in extra:
            target.writestr(info, data)
    return out


def edit(old, new):
    return lambda name, data: data.replace(old, new) if name == XML else data


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda n, d: None if n == XML else d, "modelDescription.xml cannot be read"),
        (lambda n, d: b"<fmiModel" if n == XML else d, "cannot be read"),
        (lambda n, d: b"" if n == XML else d, "cannot be read"),
        (edit(b'fmiVersion="3.0"', b'fmiVersion="3.1"'), "FMI 3.1; 2.0 and 3.0"),
        (edit(b'fmiVersion="3.0"', b'fmiVersion="2.1"'), "cannot be read: .*version: 2.1"),
        (edit(b"CoSimulation", b"ModelExchange"), "no co-simulation"),
        (lambda n, d: None if n.startswith("binaries/") else d, "no binary for this machine.*none"),
        (lambda n, d: b"no library" if n.startswith("binaries/") else d, "cannot be loaded"),
        (edit(b'unit="N"', b'unit="lbf"'), "in 'lbf'; N is needed"),
        (
            edit(b'<BaseUnit kg="1" m="1" s="-2" />', b'<BaseUnit kg="1" m="1" s="-2" factor="1000" />'),
            "in 'N'; N",
        ),
        (edit(b'instantiationToken="{', b'instantiationToken="{0'), "different builds"),
    ],
)
def test_fmu_with_an_invalid_description_or_binary_is_refused(tmp_path, change, word):
    bad = rewritten(build("3.0"), tmp_path / "bad.fmu", change)
    with pytest.raises(PlantError, match=f"(?s)bad.fmu.*{word}"):
        FmuHost(spec(bad))


def test_fmu_with_a_zip_bomb_is_refused_and_nothing_is_unpacked(tmp_path, temporary):
    bad = rewritten(build("3.0"), tmp_path / "bad.fmu", extra=[("resources/bomb", b"\0" * 8_000_000)])
    with pytest.raises(PlantError, match="times its packed size"):
        FmuHost(spec(bad))
    assert list(temporary.iterdir()) == []
