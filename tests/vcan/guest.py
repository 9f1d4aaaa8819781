"""The inner side of `uml.py`: make vcan0, run one command, leave its exit code in the run folder.

Standard library only, and this file alone. It runs either in a separate network namespace or as process 1 of
a user-mode kernel. It reports to the outside through files in the run folder.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path

RTM_NEWLINK = 16
NLM_F_REQUEST, NLM_F_ACK, NLM_F_EXCL, NLM_F_CREATE = 0x1, 0x4, 0x200, 0x400
IFLA_IFNAME, IFLA_MTU, IFLA_TXQLEN, IFLA_LINKINFO, IFLA_INFO_KIND = 3, 4, 13, 18, 1
IFF_UP = 0x1
CANFD_MTU = 72
RB_POWER_OFF = 0x4321FEDC
PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23
TIME_LIMIT_EXIT = 124


def attribute(kind: int, payload: bytes) -> bytes:
    """One route attribute, padded to four bytes."""
    size = 4 + len(payload)
    return struct.pack("=HH", size, kind) + payload + b"\0" * (-size % 4)


def request_link(flags: int, index: int, attributes: bytes) -> None:
    """Send one RTM_NEWLINK (interface up) and wait for the kernel's answer.

    Raises
    ------
    OSError
        Error of the kernel: EOPNOTSUPP if it lacks the link type.
    """
    body = struct.pack("=BxHiII", socket.AF_UNSPEC, 0, index, IFF_UP, IFF_UP) + attributes
    header = struct.pack("=IHHII", 16 + len(body), RTM_NEWLINK, NLM_F_REQUEST | NLM_F_ACK | flags, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.settimeout(5.0)
        netlink.send(header + body)
        (code,) = struct.unpack_from("=i", netlink.recv(4096), 16)
    if code != 0:
        raise OSError(-code, os.strerror(-code))


def make_vcan(name: str) -> None:
    """Create the virtual CAN interface `name`, CAN FD included, and bring it up; bring up an existing one."""
    link_info = attribute(IFLA_LINKINFO, attribute(IFLA_INFO_KIND, b"vcan"))
    length = struct.pack("=I", CANFD_MTU), struct.pack("=I", 1000)
    options = attribute(IFLA_MTU, length[0]) + attribute(IFLA_TXQLEN, length[1])
    try:
        request_link(
            NLM_F_CREATE | NLM_F_EXCL, 0, attribute(IFLA_IFNAME, name.encode()) + options + link_info
        )
    except FileExistsError:
        request_link(0, socket.if_nametoindex(name), b"")


def prepare_bare_kernel() -> None:
    """Mount the file systems that programs expect.

    Root, /proc, /sys and /dev are mounted by the init script.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    for kind, folder, options in (
        (b"devpts", "/dev/pts", b"ptmxmode=666"),
        (b"tmpfs", "/dev/shm", b""),
        (b"tmpfs", "/run", b"mode=755"),
    ):
        Path(folder).mkdir(parents=True, exist_ok=True)
        if libc.mount(kind, folder.encode(), kind, 0, options) != 0:
            raise OSError(ctypes.get_errno(), f"cannot mount {folder}")
    for name, target in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        path = Path("/dev") / name
        if not path.is_symlink():
            path.symlink_to(f"/proc/self/fd{target}")
    request_link(0, socket.if_nametoindex("lo"), b"")
    # The guest has one CPU: a busy process with real-time priority would keep all others from starting.
    if libc.prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "cannot give up real-time priority")


def run_job(folder: Path) -> int:
    """Run the command of `job.json` with its output in files; return its exit code, 124 at the time limit."""
    job = json.loads((folder / "job.json").read_text())
    runtime = Path("/run/user/0") if os.getpid() == 1 else folder / "runtime"
    runtime.mkdir(mode=0o700, parents=True, exist_ok=True)
    environment = {**job["environment"], "XDG_RUNTIME_DIR": str(runtime)}
    with (folder / "stdout").open("wb") as out, (folder / "stderr").open("wb") as err:
        process = subprocess.Popen(
            job["command"],
            cwd=job["folder"],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
        )
        try:
            return process.wait(job["limit_s"])
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return TIME_LIMIT_EXIT


def main() -> None:
    """Prepare, report ready, run, report the exit code; as process 1 switch the machine off."""
    folder = Path(sys.argv[1])
    bare = os.getpid() == 1
    try:
        try:
            if bare:
                prepare_bare_kernel()
            make_vcan("vcan0")
        except OSError as error:
            (folder / "refused").write_text(f"{error}")
            return
        (folder / "ready").touch()
        code = run_job(folder)
        partial = folder / "exit_code.new"
        partial.write_text(f"{code}")
        partial.rename(folder / "exit_code")
    finally:
        if bare:
            os.sync()
            ctypes.CDLL(None).reboot(RB_POWER_OFF)


if __name__ == "__main__":
    main()
