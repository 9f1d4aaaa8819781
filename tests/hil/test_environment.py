"""What a log has of the machine and the software that wrote it."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from hil.record.environment import PACKAGES, environment, product_version, scheduling


def test_a_log_has_version_packages_processor_and_sources():
    found = environment()
    assert found["cpu"] in Path("/proc/cpuinfo").read_text()
    assert (found["version"], found["cpus"], found["byte_order"]) == (
        product_version(), str(os.cpu_count()), sys.byteorder,
    )  # fmt: skip
    assert found["python"].split()[1] == ".".join(map(str, sys.version_info[:3]))
    packages = {
        key.removeprefix("package."): text for key, text in found.items() if key.startswith("package.")
    }
    assert packages == {name: version(name) for name in packages}
    assert {"numpy", "mcap", "protobuf"} <= packages.keys() <= set(PACKAGES)
    root = Path(__file__).parents[2]
    head = subprocess.run(
        ["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    )
    assert head.stdout.strip() in found.get("git", "")


@pytest.mark.parametrize(
    ("policy", "priority", "scheduler"),
    [
        (os.SCHED_OTHER, 0, "other 0"),
        (os.SCHED_RR | os.SCHED_RESET_ON_FORK, 7, "rr 7"),
        (99, 1, "99 1"),
    ],
)
def test_scheduler_and_processors_are_those_of_this_process(monkeypatch, policy, priority, scheduler):
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: policy)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(priority))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {10, 2, 3})
    assert scheduling() == {"scheduler": scheduler, "affinity": "2,3,10"}
