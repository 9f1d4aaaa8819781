"""Misbehaving FMUs in a child process: each causes a PlantError that gives the reason."""

import atexit
import contextlib
import functools
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.child import ChildHost
from plant_fmu.fmu.host import FmuHost
from plant_fmu.stewart.build import build, find_compiler
from tests.broad import broad

FORCE, OPEN = np.full(6, 3600.0), np.zeros(6)
STEP_LINE = "const Status status = instance_step(instance, time, dt);"


def spec(path):
    return FmuSpec(path=str(path), force=["force"], length=["length"], rate=["rate"], brake=["brake"])


FACE = "fmi3.c"


@functools.cache
def compiled():
    """Compile the parts of our FMU that `altered` does not change; return their folder and objects."""
    folder = Path(tempfile.mkdtemp(prefix="hil-test-"))
    atexit.register(shutil.rmtree, folder)
    with zipfile.ZipFile(build("3.0")) as source:
        source.extractall(folder)
    units = [p.name for p in (folder / "sources").glob("*.c") if p.name != FACE]
    compile_c(folder / "sources", "-c", *units)
    return folder, sorted((folder / "sources").glob("*.o"))


def compile_c(folder, *arguments):
    """Compile in a folder as our FMU is compiled, but faster."""
    flags = ["-std=gnu99", "-O0", "-fPIC", "-fvisibility=hidden"]
    subprocess.run([*find_compiler().command, *flags, *arguments], cwd=folder, check=True)


def altered(folder, code, line=STEP_LINE):
    """Compile our FMU with other C code in place of one line."""
    out = folder / "altered.fmu"
    ours, objects = compiled()
    text = (ours / "sources" / FACE).read_text()
    assert line in text
    face = folder / FACE
    face.write_text("#include <stdlib.h>\n#include <unistd.h>\n" + text.replace(line, code))
    with zipfile.ZipFile(build("3.0")) as source, zipfile.ZipFile(out, "w") as target:
        library = next(n for n in source.namelist() if n.startswith("binaries/"))
        include = f"-I{ours / 'sources'}"
        compile_c(folder, include, "-shared", "-o", "altered", FACE, *map(str, objects), "-lm")
        for name in source.namelist():
            given = {library: folder / "altered", f"sources/{FACE}": face}.get(name, ours / name)
            target.write(given, name)
    return out


@pytest.mark.parametrize(
    ("code", "word"),
    [
        ("abort();", "died of SIGABRT"),
        ("*(volatile int *)0 = 1;", "died of SIGSEGV"),
        ("exit(0);", "ended itself with exit code 0"),
        ("for (;;) usleep(1000);", "did not step within 0.5 s"),
    ],
)
def test_crash_exit_or_hang_of_an_fmu_raises_a_permanent_plant_error(tmp_path, monkeypatch, code, word):
    monkeypatch.setattr("plant_fmu.fmu.child.STEP_TIMEOUT_S", 0.5)
    path = altered(tmp_path, f"{code} const Status status = OK;")
    host = ChildHost(spec(path))
    host.reset()
    with pytest.raises(PlantError, match=word):
        host.step(FORCE, OPEN, OPEN, 1e-3)
    with pytest.raises(PlantError, match=word):  # and again
        host.step(FORCE, OPEN, OPEN, 1e-3)
    assert host._process.poll() is not None
    host.close()
    with pytest.raises(PlantError, match=word):
        host.step(FORCE, OPEN, OPEN, 1e-3)


GREEDY = "for (int k = 0; k < 4096; k++) { char *p = malloc(1 << 20); if (!p) %s; memset(p, 1, 1 << 20); }"


@pytest.mark.parametrize("then", broad(["abort()", "return ERROR"], quick=1))
def test_fmu_in_a_child_process_cannot_allocate_more_than_its_memory_limit(tmp_path, monkeypatch, then):
    monkeypatch.setattr("plant_fmu.fmu.child.STEP_TIMEOUT_S", 60)
    path = altered(tmp_path, f"{GREEDY % then} {STEP_LINE}")
    limited = spec(path).model_copy(update={"memory_GB": 1.0})
    said = r"memory limit is 1 GB \(plant\.model\.memory_GB\)" if then == "abort()" else "refused to step"
    with contextlib.closing(ChildHost(limited)) as host, pytest.raises(PlantError, match=said):
        host.step(FORCE, OPEN, OPEN, 1e-3)


FLAGS = "*event_needed = *terminate = *early_return = false;"
NOT_FINITE = """
ACCESS(GetGood, SetFloat64, double, FLOAT64)
API fmi3GetFloat64(void *c, const Ref vr[], size_t n, double values[], size_t n_values)
{
    const Status status = fmi3GetGood(c, vr, n, values, n_values);
    const Plant *plant = &((Instance *)c)->plant;
    if (plant->mode == STEPPING && plant->steps > 0) values[8] = 0.0 / 0.0;
    return status;
}
"""


@pytest.mark.parametrize("kind", [FmuHost, ChildHost])
@pytest.mark.parametrize(
    ("line", "code", "word"),
    [
        ("ACCESS(GetFloat64, SetFloat64, double, FLOAT64)", NOT_FINITE, "not finite"),
        (FLAGS, f"{FLAGS} *terminate = true;", r"ended the simulation at 0\.001 s"),
        (FLAGS, f"{FLAGS} *early_return = true;", "returned early"),
        (STEP_LINE, f"if (time >= 0) return ERROR; {STEP_LINE}", "refused to step"),
        (STEP_LINE, f"if (time >= 0) return 9; {STEP_LINE}", "refused to step"),
    ],
    ids=["NaN", "ends", "early", "refuses", "unknown status"],
)
def test_failed_step_of_an_fmu_is_reported_with_its_reason(tmp_path, kind, line, code, word):
    with contextlib.closing(kind(spec(altered(tmp_path, code, line)))) as host:
        host.reset()
        with pytest.raises(PlantError, match=word):
            host.step(FORCE, OPEN, OPEN, 1e-3)


@pytest.mark.parametrize("kind", [FmuHost, ChildHost])
def test_error_of_an_fmu_without_an_fmi_function_gives_the_function(tmp_path, kind):
    path = altered(tmp_path, "API FMI(fmi3DoStepX)(", "API FMI(fmi3DoStep)(")
    with pytest.raises(PlantError, match="fmi3DoStep"):
        kind(spec(path))


def test_child_process_of_an_fmu_that_hangs_while_closing_is_killed(tmp_path, monkeypatch):
    line = "return instance_new(name, token"
    (tmp_path / "fmu").mkdir()
    path = altered(tmp_path / "fmu", f"atexit((void (*)(void))pause); {line}", line)
    monkeypatch.setattr("plant_fmu.fmu.child.CLOSE_TIMEOUT_S", 0.5)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    host = ChildHost(spec(path))
    host.close()
    assert host._process.returncode == -signal.SIGKILL
    assert [p.name for p in tmp_path.iterdir()] == ["fmu"]


def test_an_fmu_that_exits_while_loading_is_reported(tmp_path):
    line = "return instance_new(name, token"
    path = altered(tmp_path, f"_exit(7); {line}", line)
    with pytest.raises(PlantError, match="exit code 7 during load"):
        ChildHost(spec(path))


def test_errors_in_the_child_process_of_an_fmu_reach_the_caller():
    with pytest.raises(PlantError, match="no such file"):
        ChildHost(spec("/nowhere/x.fmu"))
    host = ChildHost(spec(build("3.0")))
    with pytest.raises(PlantError, match=r"brake\[1\] = 2 lies outside 0 to 1"):
        host.step(FORCE, OPEN + 2, OPEN, 1e-3)
    host.step(FORCE, OPEN, OPEN, 1e-3)
    process = host._process
    host.close()
    host.close()
    assert process.returncode == 0
    with pytest.raises(PlantError, match="closed"):
        host.step(FORCE, OPEN, OPEN, 1e-3)


def test_killed_child_process_of_an_fmu_is_reported():
    host = ChildHost(spec(build("3.0")))
    os.kill(host._process.pid, signal.SIGKILL)
    with pytest.raises(PlantError, match="died of SIGKILL"):
        host.step(FORCE, OPEN, OPEN, 1e-3)
    host.close()


@pytest.fixture
def on_one_processor():
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(5))
    except PermissionError:
        os.sched_setaffinity(0, before)
        pytest.skip("no right to SCHED_FIFO")
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    yield
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.sched_setaffinity(0, before)


def test_fmu_process_in_an_endless_loop_is_stopped_by_the_real_time_loop(
    tmp_path, monkeypatch, on_one_processor
):
    """The child runs one priority below the loop that waits for it."""
    monkeypatch.setattr("plant_fmu.fmu.child.STEP_TIMEOUT_S", 0.5)
    host = ChildHost(spec(altered(tmp_path, f"if (time > 0.0005) for (;;); {STEP_LINE}")))
    child = host._process.pid
    assert os.sched_getscheduler(child) == os.SCHED_OTHER
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(5))
    host.reset()
    assert os.sched_getscheduler(child) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    assert os.sched_getparam(child).sched_priority == 4
    host.step(FORCE, OPEN, OPEN, 1e-3)
    begun = time.monotonic()
    with pytest.raises(PlantError, match=r"did not step within 0\.5 s"):
        host.step(FORCE, OPEN, OPEN, 1e-3)
    assert time.monotonic() - begun < 2.0
    host.close()


def alive(pid):
    try:
        return not re.search(r"^State:\s+[ZX]", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("code", broad(["for (;;) usleep(1000);", ""], quick=1))
def test_child_process_of_an_fmu_ends_with_its_parent_and_leaves_no_files(tmp_path, code):
    path = altered(tmp_path, f"{code} {STEP_LINE}")
    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    program = f"""
import sys, numpy as np
from pathlib import Path
from plant_fmu.fmu import child
from plant_fmu.fmu.check import FmuSpec
child.STEP_TIMEOUT_S = 60
host = child.ChildHost(FmuSpec(path={str(path)!r}, force=["force"], length=["length"], rate=["rate"]))
print(host._process.pid, flush=True)
while True:
    host.step(np.zeros(6), np.ones(6), np.zeros(6), 1e-3)
"""
    command, there = [sys.executable, "-c", program], {**os.environ, "TMPDIR": str(unpacked)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=there) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        time.sleep(0.1)
        assert alive(pid)
        assert list(unpacked.iterdir())
        parent.kill()
    deadline = time.monotonic() + 3.0
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not alive(pid)
    assert list(unpacked.iterdir()) == []


def test_child_process_of_an_fmu_has_its_own_session_and_gets_no_ctrl_c():
    with contextlib.closing(ChildHost(spec(build("3.0")))) as host:
        assert os.getsid(host._process.pid) == host._process.pid
        assert host.internal_step_s == 1e-3
