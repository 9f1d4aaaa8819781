"""`hil doctor` on recorded trees of /proc, /sys and /dev, independent of the machine of the test."""

from __future__ import annotations

import shutil
import struct
import subprocess
from importlib import resources
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.can.can_interface import FD_MTU
from hil.app import doctor
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.cli import main

ROOT = Path(__file__).resolve().parents[3]
CPU = "sys/devices/system/cpu"
LIMITS = """Limit                     Soft Limit           Hard Limit           Units
Max locked memory         {memory:<20} unlimited            bytes
Max realtime priority     {priority:<20} 99
"""
INTERRUPTS = """           CPU0       CPU1       CPU2       CPU3
 24:          7          0          0      91234  IR-PCI-MSI 327680-edge      xhci_hcd
 25:         12          0          0          0  IR-PCI-MSI 1048576-edge     nvme0q0
NMI:          0          0          0          3  Non-maskable interrupts
"""
PC = {
    "proc/self/limits": LIMITS.format(memory=8388608, priority=0),
    "proc/self/status": "CapEff:\t0000000000000000\n",
    "proc/version": "Linux version 6.1.0-28-amd64 (debian-kernel@lists.debian.org) #1 SMP PREEMPT_DYNAMIC",
    "proc/interrupts": INTERRUPTS,
    "proc/irq/24/effective_affinity_list": "3\n",
    "proc/irq/25/effective_affinity_list": "0\n",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet\n",
    f"{CPU}/online": "0-3\n",
    f"{CPU}/isolated": "\n",
    f"{CPU}/cpu3/cpufreq/scaling_governor": "powersave\n",
    f"{CPU}/cpu3/cpufreq/cpuinfo_min_freq": "400000\n",
    f"{CPU}/cpu3/cpufreq/cpuinfo_max_freq": "3600000\n",
    f"{CPU}/cpu3/cpuidle/state0/name": "POLL\n",
    f"{CPU}/cpu3/cpuidle/state0/latency": "0\n",
    f"{CPU}/cpu3/cpuidle/state1/name": "C10\n",
    f"{CPU}/cpu3/cpuidle/state1/latency": "890\n",
    "sys/class/net/can0/tx_queue_len": "10\n",
}
"""A mini PC with Debian 12 as installed; an x86 machine's files, cut to what is read."""
TUNED = {
    "proc/self/limits": LIMITS.format(memory="unlimited", priority=90),
    "proc/self/status": "CapEff:\t0000000000000000\n",
    "proc/device-tree/model": "Raspberry Pi 5 Model B Rev 1.0\0",
    "sys/kernel/realtime": "1\n",
    "proc/interrupts": INTERRUPTS.replace("91234", "    0"),
    "proc/irq/24/effective_affinity_list": "3\n",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "arch_sys_counter\n",
    f"{CPU}/online": "0-3\n",
    f"{CPU}/isolated": "3\n",
    f"{CPU}/cpu3/cpufreq/scaling_governor": "performance\n",
    f"{CPU}/cpu3/cpufreq/cpuinfo_min_freq": "1500000\n",
    f"{CPU}/cpu3/cpufreq/cpuinfo_max_freq": "2400000\n",
    f"{CPU}/cpu3/cpuidle/state0/name": "WFI\n",
    f"{CPU}/cpu3/cpuidle/state0/latency": "1\n",
    "sys/class/net/can0/tx_queue_len": "32\n",
}
"""A Raspberry Pi 5 as the guide leaves it."""


def tree(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def configuration(folder: Path, rate_Hz: float = 1000.0, cpu: int | None = 3, **bus: object) -> Configuration:
    """The shipped `socketcan` with CAN FD, so that 1 kHz fits its bus."""
    text = resources.files("configs").joinpath("socketcan.yaml").read_text(encoding="utf-8")
    loop = {"rate_Hz": rate_Hz, **({} if cpu is None else {"cpu": cpu})}
    watchdog = {"watchdog_ms": max(10.0, 5e3 / rate_Hz)}
    changes = {"loop": loop, "bus": {"layout": "fd", **bus}, "drives": watchdog}
    return loads(with_changes(text, changes), "my.yaml", folder)


def attribute(kind: int, payload: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(payload), kind) + payload + bytes(-len(payload) % 4)


def link(bitrate: int = 1_000_000, fast: int = 5_000_000, restart_ms: int = 0) -> bytes:
    """RTM_NEWLINK of a CAN controller that is up, by linux/if_link.h and linux/can/netlink.h."""
    data = attribute(1, struct.pack("=8I", bitrate, *[0] * 7)) + attribute(
        9, struct.pack("=8I", fast, *[0] * 7)
    )
    data += attribute(4, struct.pack("=I", 0)) + attribute(5, struct.pack("=II", 0x20, 0x20))
    data += attribute(6, struct.pack("=I", restart_ms))
    info = attribute(1, b"can\0") + attribute(2, data)
    head = struct.pack("=BxHiII", 0, 280, 3, 1, 0)
    return head + attribute(4, struct.pack("=I", FD_MTU)) + attribute(18, info)


def found(c: Configuration, root: Path, answer: bytes | None = None) -> dict[str, str]:
    """Subject -> command of each finding but those about disk and qualification."""
    _, summary = doctor.examine(c, root, lambda _: link() if answer is None else answer)
    rows = summary["findings"]
    return {row["subject"]: row["command"] for row in rows if row["found"] != "not qualified"}


def test_untuned_pc_gets_a_command_for_each_finding(tmp_path):
    rows = found(configuration(tmp_path), tree(tmp_path, PC))
    assert list(rows) == [
        "scheduler", "memlock", "kernel", "governor", "C-states", "CPU", "IRQ", "can0",
    ]  # fmt: skip
    assert "rtprio 90" in rows["scheduler"]
    assert rows["kernel"] == "sudo apt install linux-image-rt-amd64"
    assert rows["IRQ"].startswith("for i in 24; do echo 0,1,2 ")
    assert "isolcpus=3 rcu_nocbs=3 irqaffinity=0,1,2" in rows["CPU"]
    assert rows["can0"] == "sudo ip link set can0 txqueuelen 32"


@pytest.mark.parametrize(
    ("rate_Hz", "subjects"),
    [
        (20, {"scheduler", "memlock", "can0"}),
        (100, {"scheduler", "memlock", "can0"}),
        (200, {"scheduler", "memlock", "kernel", "C-states", "governor", "can0"}),
        (500, {"scheduler", "memlock", "kernel", "C-states", "governor", "CPU", "can0"}),
    ],
)
def test_slower_loop_gets_only_findings_that_matter_at_its_rate(tmp_path, rate_Hz, subjects):
    """A finding matters from a tenth of the period on: 5 ms at 20 Hz, 200 us at 500 Hz."""
    assert set(found(configuration(tmp_path, rate_Hz), tree(tmp_path, PC))) == subjects


def test_tuned_raspberry_pi_has_no_finding(tmp_path):
    assert found(configuration(tmp_path), tree(tmp_path, TUNED)) == {}


@pytest.mark.parametrize(
    ("changes", "subject", "word"),
    [
        ({"proc/self/limits": LIMITS.format(memory="unlimited", priority=79)}, "scheduler", "rtprio"),
        ({"proc/self/limits": LIMITS.format(memory=65536, priority=80)}, "memlock", "memlock unlimited"),
        ({"sys/kernel/realtime": "0\n", "proc/version": "Linux version 6.6"}, "kernel", "linux-image-rpi-v8-rt"),
        ({"proc/interrupts": INTERRUPTS}, "IRQ", "/proc/irq/$i"),
        ({f"{CPU}/isolated": "1-2\n"}, "CPU", "/boot/firmware/cmdline.txt"),
        ({f"{CPU}/cpu3/cpufreq/scaling_governor": "ondemand\n"}, "", ""),
        ({f"{CPU}/cpu3/cpufreq/scaling_governor": "ondemand\n",
          f"{CPU}/cpu3/cpufreq/cpuinfo_min_freq": "1000000\n"}, "governor", "cpupower"),
        ({"sys/devices/system/clocksource/clocksource0/current_clocksource": "jiffies\n"}, "clock source", "tsc"),
        ({f"{CPU}/cpu3/cpuidle/state0/latency": "150\n"}, "C-states", "udev"),
        ({f"{CPU}/cpu3/cpuidle/state0/latency": "150\n", f"{CPU}/cpu3/cpuidle/state0/disable": "1\n"}, "", ""),
        ({f"{CPU}/cpu3/cpuidle/state0/latency": "150\n", "dev/cpu_dma_latency": ""}, "", ""),
        ({"sys/class/net/can0/tx_queue_len": "15\n"}, "can0", "txqueuelen 32"),
    ],
)  # fmt: skip
def test_each_deviation_from_the_tuned_machine_is_found_alone(tmp_path, changes, subject, word):
    rows = found(configuration(tmp_path), tree(tmp_path, TUNED | changes))
    assert list(rows) == [subject] * bool(subject)
    assert word in rows.get(subject, "")


def test_capabilities_replace_the_limits(tmp_path):
    limits = LIMITS.format(memory=65536, priority=0)
    capable = {"proc/self/limits": limits, "proc/self/status": f"CapEff:\t{1 << 14 | 1 << 23:016x}\n"}
    assert found(configuration(tmp_path), tree(tmp_path, TUNED | capable)) == {}


def test_interface_is_compared_with_the_section_bus(tmp_path):
    root = tree(tmp_path, TUNED)
    assert "bitrate 1000000" in found(configuration(tmp_path), root, link(bitrate=500_000))["can0"]
    c = configuration(tmp_path, options={"restart_ms": 100})
    assert "restart-ms 100" in found(c, root, link())["can0"]
    assert found(c, root, link(restart_ms=100)) == {}


def test_interface_without_qualification_is_a_hint(tmp_path):
    _, summary = doctor.examine(configuration(tmp_path), tree(tmp_path, TUNED), lambda _: link())
    assert [row["command"] for row in summary["findings"]] == ["hil adapter my.yaml"]
    assert summary["success"]


@pytest.mark.parametrize("name", ["virtual", "two_buses", "lab-cia402"])
def test_machine_without_readable_files_has_no_finding(tmp_path, name):
    """A container may hide /proc and /sys."""
    lines, summary = doctor.examine(load(name), tmp_path)
    assert summary["findings"] == []
    assert len(lines) == 1


def test_missing_interface_is_one_finding(tmp_path):
    def missing(_: str) -> bytes:
        raise OSError(19, "No such device")

    _, summary = doctor.examine(configuration(tmp_path), tree(tmp_path, {}), missing)
    assert [row["found"] for row in summary["findings"]] == ["does not exist"]


def test_cpu_of_the_loop_that_does_not_exist_is_found(tmp_path):
    assert found(configuration(tmp_path, cpu=7), tree(tmp_path, TUNED)) == {"CPU": "loop.cpu: 3"}


def test_list_without_cpu_numbers_is_empty(tmp_path):
    """Some kernels write (null) for no CPU."""
    rows = found(configuration(tmp_path), tree(tmp_path, TUNED | {f"{CPU}/isolated": "(null)\n"}))
    assert list(rows) == ["CPU"]


def test_command_runs_on_this_machine():
    done = CliRunner().invoke(main, ["doctor", "virtual"])
    assert done.exit_code in {0, 1}
    assert done.output.startswith("this machine for virtual at 1000 Hz: ")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze")
def test_systemd_accepts_the_unit(tmp_path):
    """With the program where the unit expects it; the version of systemd here says what it does not know."""
    program, units = tmp_path / "opt/hil/bin/hil", tmp_path / "etc/systemd/system"
    program.parent.mkdir(parents=True)
    units.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    for target in ("sysinit", "basic", "shutdown", "network"):
        (units / f"{target}.target").write_text(f"[Unit]\nDescription={target}\n")
    unit = units / "hil@.service"
    unit.write_text((ROOT / "configs/systemd/hil@.service").read_text())
    command = ["systemd-analyze", "verify", "--man=no", f"--root={tmp_path}", "hil@my.service"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "hil@" not in done.stderr, done.stderr
    assert done.returncode == 0, done.stderr
    unit.write_text(unit.read_text().replace("KillMode=mixed", "KillMode=mixd"))
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "kill mode" in done.stderr
