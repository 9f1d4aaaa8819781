"""Targets of the fuzzer: for each kind of input its source, its damage, and its reader.

A reader returns its output, or raises a HilError. Any other exception is a finding.
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import zipfile
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from random import Random

from click.testing import CliRunner

from drivers.errors import HilError
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.app.configuration.controller_file import read_controller
from hil.app.configuration.section_file import read_section
from hil.app.sim.commands import CommandScript, read_commands
from hil.app.simulation import sim
from hil.cli import main
from hil.config.design import Design
from hil.config.reference import SampledReference
from hil.lab.calibrate.command import read_pairs
from hil.operate.channel import OperatorChannel
from hil.record.log import Log
from hil.trajectory.sampled import sampled_trajectory
from plant_fmu.stewart.build import build
from tools.fuzz import container

ROOT = Path(__file__).resolve().parents[2]


def stock(folder: Path, duration_s: float = 0.12) -> Path:
    """Make the valid logs in a folder, of controller and plant of a short run of `virtual`; return it."""
    if not (folder / "sound.mcap").exists():
        sim("virtual", log=folder / "sound.mcap", duration_s=duration_s, plant_log=True)
    return folder


def _command(*words: str) -> str:
    """Output of a command of `hil`, run in this process; raises its exceptions."""
    result = CliRunner().invoke(main, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    if result.exit_code not in {0, 1, 2}:
        raise AssertionError(f"exit code {result.exit_code}, allowed: 0, 1, 2")
    return result.output


def _api(path: str) -> str:
    """Read a log through every method of `hil.Log`."""
    log = Log(path)
    streams: list[Callable[[], Iterable[object]]] = [log.blocks, log.can_frames, log.ticks, log.events]
    streams += [log.figures, lambda: log.summary, lambda: log.frame("tau"), lambda: log.configuration]
    for stream in streams:
        with contextlib.suppress(HilError):
            deque(stream(), maxlen=0)
    return ""


_VIEW = "view", "--no-start", "--with"
_COLUMNS = "-c", "dq_d - dq", "-c", "t_ns", "-c", "faults", "-c", "R", "-c", "lyapunov", "-c", "latch_ns"
LOG_READERS: dict[str, Callable[[str, str], str]] = {
    "replay": lambda log, _: _command("replay", log),
    "salvage": lambda log, out: _command("replay", log, "--salvage", f"{out}.mcap"),
    "report": lambda log, out: _command("report", log, "--out", f"{out}.html"),
    "plot": lambda log, out: _command("plot", log, "--out", f"{out}.png"),
    "csv": lambda log, out: _command("export", log, f"{out}.csv"),
    "frames": lambda log, out: _command("export", log, f"{out}.asc", f"{out}.blf", f"{out}.log"),
    "parquet": lambda log, out: _command("export", log, f"{out}.parquet"),
    "foxglove": lambda log, out: _command(*_VIEW, "foxglove", log, "--out", out),
    "plotjuggler": lambda log, out: _command(*_VIEW, "plotjuggler", log, "--out", out),
    "columns": lambda log, out: _command("plot", log, *_COLUMNS, "--out", f"{out}.svg"),
    "what-if": lambda log, out: _command(
        "replay", log, "--set", "controller.wn_rad_s=25", "--log", f"{out}.mcap"
    ),
    "against": lambda log, _: _command("replay", log, "--against", log, "--align", "motion"),
    "learn": lambda log, out: _command("learn", log, "-o", f"{out}.csv"),
    "axes": lambda log, _: _command("identify", log),
    "delay": lambda log, _: _command("identify", log, "--delay"),
    "payload": lambda log, _: _command("identify", "payload", log),
    "Log": lambda log, _: _api(log),
}
"""Name -> reader of a log; its second argument is the stem of the name of a new file."""


def _log(rng: Random, folder: Path) -> str:
    path = folder / "damaged.mcap"
    source = folder.parent / ("sound-plant.mcap" if rng.random() < 0.1 else "sound.mcap")
    path.write_bytes(container.damaged(source.read_bytes(), rng))
    reader = rng.choice((*LOG_READERS, "replay", "salvage", "report"))
    return LOG_READERS[reader](str(path), str(folder / "made"))


def _damaged(path: Path, source: bytes, rng: Random) -> Path:
    for _ in range(rng.randint(1, 3)):
        source = rng.choice(container.TEXT)(source, rng)
    path.write_bytes(source)
    return path


def _configuration(rng: Random, folder: Path) -> str:
    source = rng.choice(sorted((ROOT / "configs").glob("*.yaml")))
    c = load(_damaged(folder / "damaged.yaml", source.read_bytes(), rng))
    build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    return ""


_PATH_CSV = "t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n" + "".join(
    f"{k},{0.1 * k},0,{1 + 0.02 * k},0,{k},0\n" for k in range(8)
)
_PAIRS_CSV = "x_m,y_m,z_m,rx_deg,ry_deg,rz_deg,l1_m,l2_m,l3_m,l4_m,l5_m,l6_m\n" + "".join(
    f"0.0{k},0,1,0,{k},0,1.4,1.4,1.4,1.4,1.4,1.4\n" for k in range(9)
)
_COMMANDS = "0.1 arm\n0.5 hold\n1 speed 40 # slower\n2 start\n3 jog x 0.5 for 1.5\n4 setpoint 0 0 1 0 0 0\n"


def _csv(rng: Random, folder: Path) -> str:
    kind = rng.randrange(3)
    path = _damaged(folder / "damaged.csv", (_PATH_CSV, _PAIRS_CSV, _COMMANDS)[kind].encode(), rng)
    if kind == 0:
        sampled_trajectory(SampledReference(type="sampled", path=path.name), folder).sample(0.5)
    elif kind == 1:
        read_pairs(path)
    else:
        CommandScript(read_commands(path), 1000.0, str(path))
    return ""


def _controller(rng: Random, folder: Path) -> str:
    kind = rng.choice(("designs", "controllers"))
    source = rng.choice(sorted((ROOT / "configs" / kind).glob("*.yaml")))
    path = _damaged(folder / "damaged.yaml", source.read_bytes(), rng)
    if kind == "designs":
        read_section(path, Design)
    else:
        read_controller(path)
    return ""


def _fmu(rng: Random, folder: Path) -> str:
    source, path = build("3.0" if rng.random() < 0.5 else "2.0"), folder / "damaged.fmu"
    if rng.random() < 0.5:
        path.write_bytes(rng.choice(container.ANY)(source.read_bytes(), rng))
    else:  # a sound archive around a damaged description
        with zipfile.ZipFile(source) as archive, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
            for name in archive.namelist():
                data = archive.read(name)
                out.writestr(
                    name, rng.choice(container.TEXT)(data, rng) if name == "modelDescription.xml" else data
                )
    return _command("fmu", "show", str(path))


_LINES = (
    "arm", "stop", "reset", "estop", "release", "end", "start", "hold", "park", "key", "speed 40",
    "jog x 0.5", "jog leg_3 -1", "setpoint 0 0 1 0 5 0", "status", "#tag setpoint 0 0 1", "#t status",
)  # fmt: skip
_numbers = itertools.count()


def _operator(rng: Random, folder: Path) -> str:
    """Send damaged lines to the socket that receives the operator's commands."""
    with (
        OperatorChannel("fuzz", f"{next(_numbers)}") as channel,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
    ):
        sender.bind(str(folder / "s"))
        sender.settimeout(1.0)
        for _ in range(50):
            line = rng.choice(_LINES).encode()
            for _ in range(rng.randint(0, 3)):
                line = rng.choice(container.TEXT)(line, rng)
            with contextlib.suppress(OSError):
                sender.sendto(line[:60_000], str(channel.path))
            heard = channel.take()
            operator, orders, setpoints = ([""] * len(kind) for kind in heard)
            channel.answer(operator, orders, setpoints, lambda: "{}")
    return ""


TARGETS: dict[str, tuple[Callable[[Random, Path], str], int]] = {
    "log": (_log, 12),
    "configuration": (_configuration, 3),
    "csv": (_csv, 2),
    "controller": (_controller, 2),
    "fmu": (_fmu, 2),
    "operator": (_operator, 1),
}
"""Kind of input -> function that runs one case, and the weight with which it is drawn."""
