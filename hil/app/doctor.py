"""`hil doctor`: findings about this machine's set-up for a loop rate, each with the command that fixes it.

Reads `sys`, `proc` and `dev` below a root folder, so a recorded tree stands for another machine. Each
finding has a cost: how much later it can make a tick, an assumption where the machine does not state it. It
is listed from LATE_PERIODS of the period on, the lateness from which the loop counts a wake-up as late.
"""

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from drivers.can import netlink
from drivers.can.can_interface import parse, refusal
from hil.app.adapter.qualification import qualifications
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.configuration import Configuration
from hil.loop.clock import LATE_PERIODS, STALL_S

TICK_US = 100.0
"""Processor time of a tick at full clock, us, with room: 20 us are measured on a PC."""
LOCKED_BYTES = 1 << 30
"""Locked memory that a run may need."""
_IPC_LOCK, _SYS_NICE = 14, 23
"""Numbers of the capabilities CAP_IPC_LOCK and CAP_SYS_NICE."""
_CPU = "sys/devices/system/cpu"
_LIMITS = "/etc/security/limits.d/90-hil.conf"
_READS = 20
"""Readings of the clock in a tick."""
_SLOW_CLOCKS = {"hpet": 1.0, "acpi_pm": 3.0, "jiffies": 1e4, "refined-jiffies": 1e4}
"""Time of one reading of a slow clock source, or its resolution, us."""


class Finding(NamedTuple):
    """One row: what was found, why it matters, the command that fixes it."""

    state: str
    """fix: a run is at risk; hint: a run may be later than needed."""
    subject: str
    found: str
    why: str
    command: str
    cost_us: float
    """Lateness that it can cause, us; inf where it is no matter of time."""


class Machine(NamedTuple):
    """A machine by its files below `root`; link: the kernel's answer about a network interface."""

    root: Path
    link: Callable[[str], bytes]

    def read(self, path: str) -> str:
        """Text of a file without surrounding blanks; empty if it is missing or unreadable."""
        try:
            return (self.root / path).read_text(errors="replace").strip()
        except OSError:
            return ""

    def number(self, path: str) -> int:
        """Number in a file; 0 if the file or the number is missing."""
        text = self.read(path)
        return int(text) if text.isdecimal() else 0

    def allows(self, resource: str, wanted: int, capability: int) -> bool:
        """True if the soft limit of a resource is at least `wanted`, or the process has the capability."""
        limit = re.search(rf"^{resource}\s+(\S+)", self.read("proc/self/limits"), re.MULTILINE)
        effective = re.search(r"^CapEff:\s*(\w+)", self.read("proc/self/status"), re.MULTILINE)
        if limit is None or (effective and int(effective[1], 16) >> capability & 1):
            return True
        return limit[1] == "unlimited" or int(limit[1]) >= wanted

    def cpus(self, path: str) -> set[int]:
        """CPU numbers of a file with a list such as `0,2-3`."""
        ranges = re.findall(r"(\d+)(?:-(\d+))?", self.read(path))
        return {n for first, last in ranges for n in range(int(first), int(last or first) + 1)}

    def cpu(self, c: Configuration) -> int:
        """CPU of the loop: loop.cpu, else the last one, which suits it."""
        return max(self.cpus(f"{_CPU}/online"), default=0) if c.loop.cpu is None else c.loop.cpu

    @property
    def pi(self) -> bool:
        """True on a Raspberry Pi."""
        return "Raspberry Pi" in self.read("proc/device-tree/model")


def _rights(m: Machine, c: Configuration) -> Iterator[Finding]:
    grant = f'echo "$USER - {{}}" | sudo tee -a {_LIMITS}; then log in again'
    if not m.allows("Max realtime priority", c.loop.priority, _SYS_NICE):
        why = f"no SCHED_FIFO: any program may hold up the loop, for {1e3 * STALL_S:.0f} ms and more"
        text, fix = f"loop.priority {c.loop.priority} is not allowed", grant.format("rtprio 90")
        yield Finding("fix", "scheduler", text, why, fix, 1e6 * STALL_S)
    if not m.allows("Max locked memory", LOCKED_BYTES, _IPC_LOCK):
        why = "memory of the loop may be paged out; reading it back takes milliseconds"
        fix = grant.format("memlock unlimited")
        yield Finding("fix", "memlock", "memory cannot be locked", why, fix, 5000.0)


def _kernel(m: Machine, _: Configuration) -> Iterator[Finding]:
    version = m.read("proc/version")
    if version and m.read("sys/kernel/realtime") != "1" and "PREEMPT_RT" not in version:
        package = "linux-image-rpi-v8-rt" if m.pi else "linux-image-rt-amd64"
        why, found = "parts of the kernel cannot be interrupted", f"no PREEMPT_RT: {version.split(' (')[0]}"
        yield Finding("fix", "kernel", found, why, f"sudo apt install {package}", 500.0)
    clock = m.read("sys/devices/system/clocksource/clocksource0/current_clocksource")
    if clock in _SLOW_CLOCKS:
        cost = _READS * _SLOW_CLOCKS[clock]
        fix = "kernel parameter clocksource=tsc, if dmesg does not call the TSC unstable"
        yield Finding("fix", "clock source", clock, f"{_READS} readings a tick", fix, cost)


def _processor(m: Machine, c: Configuration) -> Iterator[Finding]:
    cpu = m.cpu(c)
    here = f"{_CPU}/cpu{cpu}"
    governor = m.read(f"{here}/cpufreq/scaling_governor")
    low, high = (m.number(f"{here}/cpufreq/cpuinfo_{end}_freq") for end in ("min", "max"))
    if governor not in ("", "performance") and 0 < low < high:
        why = f"a tick may run at {low // 1000} instead of {high // 1000} MHz"
        command = "sudo cpupower frequency-set -g performance"
        yield Finding("fix", "governor", governor, why, command, TICK_US * (high / low - 1.0))
    states = [s.relative_to(m.root).as_posix() for s in (m.root / f"{here}/cpuidle").glob("state*")]
    exits = {m.number(f"{s}/latency"): m.read(f"{s}/name") for s in states if not m.number(f"{s}/disable")}
    if exits and not os.access(m.root / "dev/cpu_dma_latency", os.W_OK):
        why = f"waking from {exits[max(exits)]} takes {max(exits)} us, and the loop may not forbid it"
        rule = 'KERNEL=="cpu_dma_latency", GROUP="\'$(id -gn)\'", MODE="0660"'
        command = f"echo '{rule}' | sudo tee /etc/udev/rules.d/90-hil.rules; then restart"
        found = "/dev/cpu_dma_latency is not writable"
        yield Finding("fix", "C-states", found, why, command, max(exits))


def _sharing(m: Machine, c: Configuration) -> Iterator[Finding]:
    online, isolated, cpu = m.cpus(f"{_CPU}/online"), m.cpus(f"{_CPU}/isolated"), m.cpu(c)
    rest = ",".join(map(str, sorted(online - {cpu})))
    if online and cpu not in online:
        have = ",".join(map(str, sorted(online)))
        found, why = f"loop.cpu {cpu} does not exist, allowed: {have}", "the loop runs on any CPU"
        yield Finding("fix", "CPU", found, why, f"loop.cpu: {max(online)}", 200.0)
    elif rest and (c.loop.cpu is None or cpu not in isolated):
        file = "/boot/firmware/cmdline.txt" if m.pi else "/etc/default/grub, then sudo update-grub"
        set_to = "not set" if c.loop.cpu is None else c.loop.cpu
        found = f"isolated CPUs: {','.join(map(str, sorted(isolated))) or 'none'}; loop.cpu {set_to}"
        fix = f"loop.cpu: {cpu}, and isolcpus={cpu} rcu_nocbs={cpu} irqaffinity={rest} in {file}"
        why = "other programs and interrupts share the loop's CPU"
        yield Finding("hint", "CPU", found, why, fix, 200.0)
    head, *rows = [row.split() for row in m.read("proc/interrupts").splitlines()] or [[]]
    column = 1 + head.index(f"CPU{cpu}") if f"CPU{cpu}" in head else 0
    here = [irq for irq, *more in rows if column and irq[:-1].isdecimal() and more[column - 1] != "0"]
    movable = [irq[:-1] for irq in here if cpu in m.cpus(f"proc/irq/{irq[:-1]}/effective_affinity_list")]
    if rest and movable and c.loop.cpu is not None:
        fix = f"for i in {' '.join(movable)}; do echo {rest} | sudo tee /proc/irq/$i/smp_affinity_list; done"
        found = f"interrupts {', '.join(movable)} on CPU {cpu}"
        yield Finding("fix", "IRQ", found, "each takes the loop's CPU for some 10 us", fix, 100.0)


def _can(m: Machine, c: Configuration) -> Iterator[Finding]:
    budgets = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz, c.folder)
    for bus, budget, known in zip(c.bus.buses, budgets, qualifications(c), strict=False):
        name, frames = bus.channel, budget.frames.total()
        if bus.interface != "socketcan":
            continue
        try:
            why = refusal(parse(name, m.link(name)), bus)
        except OSError:
            why = "does not exist"
        if why:
            what, _, command = why.partition(": ")
            yield Finding("fix", name, what, "no run would start", command or "ip link", float("inf"))
        length = m.number(f"sys/class/net/{name}/tx_queue_len")
        if 0 < length < 2 * frames:
            command = f"sudo ip link set {name} txqueuelen {max(32, 2 * frames)}"
            found = f"txqueuelen {length}, a tick has {frames} frames"
            yield Finding("fix", name, found, "a full queue drops commands", command, float("inf"))
        if known is None and not why:
            why = "`hil check` counts no latency of the adapter"
            command = f"hil adapter {c.source}"
            yield Finding("hint", name, "not qualified", why, command, float("inf"))


CHECKS: tuple[Callable[[Machine, Configuration], Iterator[Finding]], ...] = (
    _rights, _kernel, _processor, _sharing, _can,
)  # fmt: skip


def examine(
    c: Configuration, root: Path = Path("/"), link: Callable[[str], bytes] = netlink.get_link
) -> tuple[list[str], dict[str, Any]]:
    """(lines to print, summary) of the findings that matter at loop.rate_Hz.

    root: folder of the machine. link: answer of the kernel to RTM_GETLINK for an interface.
    """
    machine, late_us = Machine(root, link), 1e6 * LATE_PERIODS / c.loop.rate_Hz
    rows = [each for check in CHECKS for each in check(machine, c) if each.cost_us >= late_us]
    fixes = sum(row.state == "fix" for row in rows)
    count = f"findings to fix: {fixes}, hints: {len(rows) - fixes}" if rows else "nothing to fix"
    lines = [f"this machine for {c.name} at {c.loop.rate_Hz:g} Hz: {count}"]
    for row in rows:
        lines.append(f"{row.state:<5}{row.subject:<13}{row.found}: {row.why}")
        lines.append(f"     {row.command}")
    if rows:
        lines.append(f"listed: what can make a tick {late_us:.0f} us late or more, or stop a run")
    findings = [row._asdict() for row in rows]
    return lines, {"success": not fixes, "kind": "doctor", "configuration": c.name, "findings": findings}
