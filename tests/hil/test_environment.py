"""What a log has of the machine and the software that wrote it."""

import os
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version

import pytest

from hil.record.environment import PACKAGES, environment, product_version, scheduling

module = import_module("hil.record.environment")


def test_a_log_has_version_packages_processor_and_clock(monkeypatch, tmp_path):
    files = {"/proc/cpuinfo": "processor\t: 0\nmodel name\t: A Processor: 3.00GHz\nmodel name\t: Another\n"}
    monkeypatch.setattr(module, "_read", lambda path: files.get(str(path), "tsc\n"))
    found = environment()
    assert (found["cpu"], found["clock"]) == ("A Processor: 3.00GHz", "tsc")
    assert (found["version"], found["cpus"], found["byte_order"]) == (
        product_version(), str(os.cpu_count()), sys.byteorder,
    )  # fmt: skip
    assert found["python"].split()[1] == ".".join(map(str, sys.version_info[:3]))
    packages = {
        key.removeprefix("package."): value for key, value in found.items() if key.startswith("package.")
    }
    assert packages == {name: version(name) for name in packages}
    assert {"numpy", "mcap", "protobuf"} <= packages.keys() <= set(PACKAGES)


@pytest.mark.parametrize(
    ("policy", "priority", "scheduler"),
    [
        (os.SCHED_OTHER, 0, "other 0"),
        (os.SCHED_FIFO, 80, "fifo 80"),
        (os.SCHED_RR | os.SCHED_RESET_ON_FORK, 7, "rr 7"),
        (99, 1, "99 1"),
    ],
)
def test_scheduler_and_processors_are_those_of_this_process(monkeypatch, policy, priority, scheduler):
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: policy)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(priority))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {10, 2, 3})
    assert scheduling() == {"scheduler": scheduler, "affinity": "2,3,10"}


@pytest.mark.parametrize("fails", [False, True])
def test_the_state_of_the_sources_is_that_of_git(monkeypatch, fails):
    def run(command, **_):
        assert command[:1] + command[3:5] == ["git", "describe", "--always"]
        if fails:
            raise subprocess.TimeoutExpired("git", 2.0)
        return subprocess.CompletedProcess([], 0, "1a2b-dirty\n", "")

    monkeypatch.setattr(module.subprocess, "run", run)
    monkeypatch.setattr(module.Path, "exists", lambda self: self.name == ".git")
    module._git.cache_clear()
    try:
        assert module._git() == ("" if fails else "1a2b-dirty")
    finally:
        module._git.cache_clear()
