"""What a log says of the machine that wrote it: from the files that the kernel has of it, and nothing that it has not."""

import os
import subprocess
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import PosixPath

import pytest

from hil.record.environment import PACKAGES, environment, product_version, scheduling

module = import_module("hil.record.environment")
CPUINFO = """processor\t: 0
vendor_id\t: GenuineIntel
model name\t: A Processor: 3.00GHz
model\t\t: 85

processor\t: 1
model name\t: Another
"""


@pytest.fixture
def kernel(monkeypatch, tmp_path):
    """A function that gives the kernel's files other contents, None for one that is not there."""

    def has(cpuinfo, clock):
        files = {"/proc/cpuinfo": cpuinfo, str(tmp_path / "clock"): clock}

        class Path(PosixPath):
            def read_text(self, *_, **__):
                content = files[str(self)]
                if content is None:
                    raise FileNotFoundError(str(self))
                return content

        monkeypatch.setattr(module, "Path", Path)
        monkeypatch.setattr(module, "_CLOCKSOURCE", Path(tmp_path / "clock"))
        monkeypatch.setattr(module, "_git", lambda: "")

    return has


def test_processor_and_clock_are_what_the_kernel_calls_them(kernel):
    kernel(CPUINFO, "tsc\n")
    found = environment()
    assert (found["cpu"], found["clock"]) == ("A Processor: 3.00GHz", "tsc")


def test_what_the_kernel_does_not_say_is_left_out_or_asked_elsewhere(kernel, monkeypatch):
    monkeypatch.setattr(module.platform, "processor", lambda: "aarch64")
    kernel("processor\t: 0\n", None)
    assert environment()["cpu"] == "aarch64"
    kernel(None, None)
    monkeypatch.setattr(module.platform, "processor", lambda: "")
    found = environment()
    assert not {"cpu", "clock", "git"} & found.keys()
    assert all(found.values())


def test_versions_are_those_that_are_installed(kernel, monkeypatch):
    kernel(CPUINFO, "tsc\n")
    found = environment()
    assert found["version"] == product_version()
    assert found["python"].split()[1] == ".".join(map(str, sys.version_info[:3]))
    packages = {
        key.removeprefix("package."): value for key, value in found.items() if key.startswith("package.")
    }
    assert packages == {name: version(name) for name in packages}
    assert {"numpy", "mcap", "protobuf"} <= packages.keys() <= set(PACKAGES)
    assert (found["cpus"], found["byte_order"]) == (str(os.cpu_count()), sys.byteorder)


@pytest.fixture
def git(monkeypatch):
    """Sources in a repository of their own."""

    class Path(PosixPath):
        def exists(self, **_):
            return self.name == ".git"

    module._git.cache_clear()
    monkeypatch.setattr(module, "Path", Path)
    yield monkeypatch
    module._git.cache_clear()


def test_the_state_of_the_sources_is_what_git_says_in_one_line_asked_once_and_for_two_seconds(git):
    asked = []

    def run(command, **how):
        asked.append((command, how))
        return subprocess.CompletedProcess([], 0, "1a2b-dirty\n", "")

    git.setattr(module.subprocess, "run", run)
    assert module._git() == module._git() == "1a2b-dirty"
    root = str(PosixPath(__file__).resolve().parents[2])
    command = ["git", "-C", root, "describe", "--always", "--dirty", "--abbrev=40"]
    assert asked == [(command, {"capture_output": True, "text": True, "timeout": 2.0, "check": True})]


def test_sources_in_no_repository_of_their_own_have_no_state(git):
    git.setattr(module.Path, "exists", lambda self: False)
    assert module._git() == ""


def test_a_program_that_is_not_installed_has_an_unknown_version_and_a_package_that_is_not_there_none(
    monkeypatch,
):
    module._version.cache_clear()
    monkeypatch.setattr("importlib.metadata.version", lambda name: "2.0" if name == "numpy" else gone(name))
    try:
        assert product_version() == "unknown"
        found = environment()
        assert found["version"] == "unknown"
        assert {name: value for name, value in found.items() if name.startswith("package.")} == {
            "package.numpy": "2.0"
        }
    finally:
        module._version.cache_clear()


def gone(name):
    raise PackageNotFoundError(name)


def test_a_system_without_schedulers_says_nothing_of_them(monkeypatch):
    monkeypatch.delattr(os, "sched_getscheduler")
    monkeypatch.delattr(os, "sched_getaffinity")
    assert scheduling() == {}


def test_a_system_whose_policies_have_no_bit_beside_them_names_them_too(monkeypatch):
    monkeypatch.delattr(os, "SCHED_RESET_ON_FORK")
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_FIFO)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(3))
    assert scheduling()["scheduler"] == "fifo 3"


def test_the_scheduler_is_that_of_this_process_and_bytes_that_are_no_text_do_not_matter(
    monkeypatch, tmp_path
):
    asked: list[tuple[str, int]] = []

    def told(name, result):
        def ask(pid):
            asked.append((name, pid))
            return result

        return ask

    monkeypatch.setattr(os, "sched_getscheduler", told("scheduler", os.SCHED_BATCH))
    monkeypatch.setattr(os, "sched_getparam", told("priority", os.sched_param(0)))
    monkeypatch.setattr(os, "sched_getaffinity", told("affinity", {1}))
    assert scheduling() == {"scheduler": "batch 0", "affinity": "1"}
    assert asked == [("scheduler", 0), ("priority", 0), ("affinity", 0)]
    (tmp_path / "clock").write_bytes(b"ts\xffc\n")
    monkeypatch.setattr(module, "_CLOCKSOURCE", tmp_path / "clock")
    assert module._clock() == "ts\ufffdc"


@pytest.mark.parametrize(
    "error",
    [
        FileNotFoundError("git"),
        subprocess.CalledProcessError(128, "git"),
        subprocess.TimeoutExpired("git", 2.0),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_git_that_fails_says_nothing(git, error):
    def refused(*_, **__):
        raise error

    git.setattr(module.subprocess, "run", refused)
    assert module._git() == ""


@pytest.mark.parametrize(
    ("policy", "priority", "said"),
    [
        (os.SCHED_OTHER, 0, "other 0"),
        (os.SCHED_FIFO, 80, "fifo 80"),
        (os.SCHED_RR | os.SCHED_RESET_ON_FORK, 7, "rr 7"),
        (99, 1, "99 1"),
    ],
)
def test_scheduler_and_processors_are_those_of_this_process(monkeypatch, policy, priority, said):
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: policy)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(priority))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {10, 2, 3})
    assert scheduling() == {"scheduler": said, "affinity": "2,3,10"}


@pytest.mark.parametrize(("count", "told"), [(64, "64"), (1, "1"), (None, None)])
def test_a_machine_has_all_its_processors_however_few_this_process_may_use(monkeypatch, count, told):
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert environment().get("cpus") == told
