"""Machine and software data in a log."""

import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from hil.record.environment import PACKAGES, environment, product_version

ROOT = Path(__file__).parents[2]


def test_a_log_records_version_packages_processor_clock_and_sources():
    found = environment()
    assert found["version"] == product_version() == version("hexapod-hil")
    assert (found["cpus"], found["byte_order"]) == (str(os.cpu_count()), sys.byteorder)
    assert found["python"].split()[1] == platform.python_version()
    assert found["cpu"] in (Path("/proc/cpuinfo").read_text() + platform.processor())
    assert found.get("clock", "none") in {"none", "tsc", "kvm-clock", "hpet", "acpi_pm", "arch_sys_counter"}
    packages = {k.removeprefix("package."): v for k, v in found.items() if k.startswith("package.")}
    assert packages == {name: version(name) for name in packages}
    assert {"numpy", "mcap", "protobuf"} <= packages.keys() <= set(PACKAGES)
    if "git" in found:
        names = [found["git"].removesuffix("-dirty"), "HEAD"]
        done = subprocess.run(["git", "-C", ROOT, "rev-parse", *names], capture_output=True, check=True)
        assert len(set(done.stdout.split())) == 1
