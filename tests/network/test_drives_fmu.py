"""Our drives and platform as a CAN FMU: the frames of the emulated drives, to the bit."""

import json
import random
import zipfile
from importlib.resources import files
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.validation import validate_fmu
from lxml import etree  # type: ignore[import-untyped]

from drivers.frame_array import received_frames
from drivers.protocol import Received
from drivers.signals import Command, DriveMode, Mode, Reaction
from hil.app.compose import build_nodes, build_protocol
from hil.app.fmu import can_parameters
from hil.app.sim.build import build_lockstep
from hil.cli.fmu import fmu_build_command
from hil.loop.run_end import Course
from plant_fmu.drives.nodes import Nodes
from plant_fmu.network import operations as op
from plant_fmu.network.node import Node
from plant_fmu.network.operations import Code, Operation
from plant_fmu.network.terminal import read_can_fmu
from plant_fmu.stewart.build import build
from tests.drivers.legs_frames import command_frames, opening, resealed
from tests.loop.bench import changed, new_cycle
from tests.network.foreign_master import OFF, READY, RUN, ForeignMaster

DATA = Path(__file__).parents[1] / "data"


class Noted(Nodes):
    """Emulated drives that note all frames, each with its time in ns."""

    address = 0  # not advanced inside the compiled tick

    def start(self, t0_ns):
        super().start(t0_ns)
        self.heard, self.sent = [], []

    def advance(self, t_ns, received):
        out = super().advance(t_ns, received)
        self.heard += [(each.t_ns, each.frame) for each in received_frames(received)]
        self.sent += [(each.t_ns, each.frame) for each in received_frames(out)]
        return out


class Bus:
    """The CAN FMU on an ideal bus; all frames that it sends, each with its time in ns."""

    def __init__(self, c):
        self.node = Node(read_can_fmu(build("3.0", bus=can_parameters(c))), "drives")
        self.sent = []
        self.exchange()

    def exchange(self, *frames):
        given = op.encode([op.from_frame(frame) for frame in frames])
        while given or self.node.next_ns() == self.node.reached_ns:
            for operation in op.decode(self.node.exchange(given)):
                assert isinstance(operation, Operation)
                if operation.code is not Code.CONFIGURATION:
                    self.sent.append((self.node.reached_ns, op.to_frame(operation)))
            given = b""

    def advance(self, t_ns):
        while (due := self.node.next_ns()) is not None and due <= t_ns:
            self.node.advance(due)
            self.exchange()
        self.node.advance(t_ns)

    def hear(self, t_ns, frame):
        self.advance(t_ns)
        self.exchange(frame)


def period(c):
    """Emulated drives of a run until one period of the path is tracked."""
    cycle = new_cycle(c)
    nodes, plant = build_nodes(c)
    noted = Noted(plant, nodes._protocol, c.plant.drives, c.drives)
    lockstep, course, tracked = build_lockstep(c, cycle, noted), Course(cycle), 0
    try:
        while tracked < 2000:
            lockstep.step(course.commands(lockstep.tick + 1))
            tracked += cycle.mode is Mode.TRACKING
            assert not cycle.faults
    finally:
        plant.close()
    return noted


@pytest.mark.parametrize("layout", ["fd"])
def test_can_fmu_answers_a_period_of_the_path_as_the_emulated_drives_to_the_bit(layout):
    c = changed("virtual", bus={"layout": layout})
    noted = period(c)
    bus = Bus(c)
    with bus.node:
        for t_ns, frame in noted.heard:
            bus.hear(t_ns, frame)
        bus.advance(noted.now_ns)
    assert len(noted.sent) > 6 * 2000
    assert bus.sent == noted.sent


def conversation(protocol, seed):
    """Frames of a controller that makes every mistake, each with its time in ns."""
    draw, t_ns, tick, frames = np.random.default_rng(seed), 0, 0, []
    configs = [protocol.configure(w, r) for w, r in ((0.004, Reaction.DAMP), (0.006, Reaction.HOLD))]
    configs += [protocol.configure(0.005, Reaction.ZERO), protocol.configure(0.01, Reaction.BRAKE)]
    (estop,) = protocol.traits.emergency_stop
    for _ in range(1500):
        t_ns += int(draw.choice([20_000, 333_333, 1_000_000, 12_000_000], p=[0.3, 0.4, 0.27, 0.03]))
        kind = draw.choice(["command", "config", "estop", "broken", "reset"], p=[0.73, 0.1, 0.01, 0.12, 0.04])
        tick += int(draw.integers(0, 3) > 0)
        pushes = 400 < tick < 500
        if pushes:
            kind = "command"
        mode = DriveMode.RESET if kind == "reset" else DriveMode(draw.choice(3, p=[0.05, 0.35, 0.6]))
        if kind == "estop":
            new = [estop]
        elif kind == "config":
            new = [configs[draw.integers(4)][draw.integers(6)]]
            if draw.random() < 0.3:  # another version of the protocol
                new = [resealed(new[0], 6, b"\1")]
        else:
            force = draw.normal(4000.0, 15_000.0 if draw.random() < 0.1 else 500.0, 6).clip(-30_700, 30_700)
            if pushes:  # until the legs are faster than layout classic can say
                steps = [*[DriveMode.RESET] * 4, *[DriveMode.READY] * 4]
                mode, force = [*steps, *[DriveMode.RUN] * 99][tick - 401], np.full(6, 30_700.0)
            new = [*opening(protocol, tick), *command_frames(protocol, Command(mode, force), tick)]
            if draw.random() < 0.05:  # a command of another SYNC
                new = [*command_frames(protocol, Command(mode, force), tick + 1)]
        broken = draw.integers(len(new))
        for k, frame in enumerate(new):
            data = bytearray(frame.data)
            if kind == "broken" and k == broken:
                data[-1 - draw.integers(len(data), size=2).min()] ^= 1 << int(draw.integers(8))
            frames.append((t_ns, frame._replace(data=bytes(data))))
            t_ns += int(draw.integers(0, 200_000))
    return frames


@pytest.mark.parametrize("layout", ["classic", "fd", "ideal"])
def test_can_fmu_reacts_to_every_mistake_of_a_controller_as_the_emulated_drives(layout):
    quick = {"drives": {"brake_open_ms": 3, "brake_close_ms": 2}}
    c = changed(
        "virtual", bus={"layout": layout}, plant=quick, loop={"rate_Hz": 500}, drives={"brake_after_ms": 8}
    )
    _, plant = build_nodes(c)
    protocol = build_protocol(c)
    assert c.plant is not None
    noted, bus, states = Noted(plant, protocol, c.plant.drives, c.drives), Bus(c), set()
    with bus.node:
        for t_ns, frame in conversation(protocol, seed=48):
            noted.step(t_ns, [Received(t_ns, frame)])
            snapshot = noted.snapshot()
            states |= set(zip(snapshot.state.tolist(), snapshot.fault.tolist(), strict=True))
            bus.hear(t_ns, frame)
    plant.close()
    assert states == {(0, 0), (1, 0), (2, 0), (3, 0), (4, 1), (4, 2)}
    assert [frame for _, frame in bus.sent] == [frame for _, frame in noted.sent]
    # A command at the very end of the watchdog time is in time, so its status comes 1 ns later.
    assert {at - t for (at, _), (t, _) in zip(bus.sent, noted.sent, strict=True)} == {0, 1}


@pytest.fixture
def master(tmp_path):
    fmu = build("3.0", bus=can_parameters(changed("virtual")))
    return ForeignMaster(fmu, tmp_path, str(files("drivers.legs") / "legs.dbc"))


def test_foreign_controller_enables_the_drives_and_holds_the_platform(master):
    start, summed, errors = None, np.zeros(6), []
    for tick in range(3000):
        master.step(1e-3 * tick)
        master.fmu.enterEventMode()
        if tick < 6:
            leg = {"Reaction": 0, "Leg": tick + 1, "Version": 2}
            master.send(f"CONFIG_{tick + 1}", Watchdog=0.01, **leg)
        master.send("SYNC", Cycle=tick % 256)
        read = [master.seen[f"FEEDBACK_FD_{k}"] for k in range(1, 7)]
        assert all(each["Counter"] == tick % 16 for each in read)
        length, rate = (np.array([each[name] for each in read]) for name in ("Length", "Rate"))
        start = length if start is None else start
        error = start - length
        mode = OFF if tick < 10 else READY if tick < 20 else RUN
        force = 1e6 * error - 2e4 * rate + summed
        summed = summed + 1e4 * error * (mode == RUN)
        forces = {f"Force{k + 1}": f for k, f in enumerate(force * (mode != OFF))}
        master.send("COMMAND_FD", Counter=tick % 256, Mode=mode, **forces)
        master.fmu.enterStepMode()
        errors.append(np.abs(error).max())
    assert all(each["State"] == 3 for each in read)
    assert 1e-3 < max(errors) < 10e-3  # it sags under its weight when the brakes open
    assert max(errors[-500:]) < 2e-5


def test_drives_of_the_can_fmu_brake_and_report_when_their_watchdog_time_has_passed(master):
    def command(mode):
        master.fmu.enterEventMode()
        master.send("SYNC", Cycle=mode)
        master.send("COMMAND_FD", Counter=mode, Mode=mode, **{f"Force{k}": 0 for k in range(1, 7)})
        master.fmu.enterStepMode()

    def reported():
        return {
            (master.seen[f"STATUS_{k}"]["State"], master.seen[f"STATUS_{k}"]["Fault"]) for k in range(1, 7)
        }

    master.fmu.enterEventMode()
    for leg in range(1, 7):
        master.send(f"CONFIG_{leg}", Watchdog=0.01, Reaction=0, Leg=leg, Version=2)
    master.fmu.enterStepMode()
    command(READY)
    master.step(0.01)
    command(RUN)  # in the last ns of the watchdog time
    master.step(0.02)
    assert reported() == {(3, 0)}
    master.step(0.020001)
    assert reported() == {(4, 1)}


def test_state_of_the_can_fmu_can_be_saved_serialised_and_set_again(master):
    def ahead():
        master.fmu.enterEventMode()
        master.send("SYNC", Cycle=7)
        master.fmu.enterStepMode()
        return dict(master.seen)

    master.step(0.02)
    state = master.fmu.getFMUState()
    first = ahead()
    saved = master.fmu.deserializeFMUState(master.fmu.serializeFMUState(state))
    master.seen.clear()
    master.fmu.enterEventMode()
    master.send("SYNC", Cycle=7)  # a repetition: no answer
    assert not master.seen
    master.fmu.setFMUState(saved)
    assert (
        ahead().keys() == {f"FEEDBACK_FD_{leg}" for leg in range(1, 7)} == {*first} - {"STATUS_1", "STATUS_2"}
    )
    master.fmu.freeFMUState(state)
    master.fmu.freeFMUState(saved)


def test_can_fmu_answers_corrupt_operations_with_a_format_error_and_ignores_others():
    draw, vectors = random.Random(48), json.loads((DATA / "ls_bus.json").read_text())
    binaries = [bytes.fromhex(each["binary"]) for each in vectors]
    for _ in range(2000):
        changed_bytes = bytearray(b"".join(draw.choices(binaries, k=draw.randint(1, 3))))
        changed_bytes[draw.randrange(len(changed_bytes))] = draw.randrange(256)
        binaries.append(bytes(changed_bytes[: draw.randint(1, len(changed_bytes))]))
    sizes = [(Code.CAN_TRANSMIT, (1, 0, 0)), (Code.CAN_FD_TRANSMIT, (1, 0, 0, 0))]
    binaries += [op.encode([Operation(*each, bytes(n))]) for each in sizes for n in range(66)]
    refused = 0
    with Bus(changed("virtual")).node as node:
        for binary in (each for each in binaries if each):
            corrupt = [each for each in op.decode(binary) if _is_refused(each)]
            answers: list[Any] = []
            given = binary
            while given or node.next_ns() == 0:
                answers += op.decode(node.exchange(given))
                given = b""
            errors = [each.data for each in answers if each.code is Code.FORMAT_ERROR]
            assert errors == [
                op.encode([each]) if isinstance(each, Operation) else each.data for each in corrupt
            ]
            refused += len(errors)
    assert refused > 1000


NOTIFICATIONS = {(0x20, 12), (0x30, 12), (0x31, 15), (0x40, 10), (0x40, 13), (0x41, 9), (0x42, 8)}
"""Operation codes and lengths of operations about the bus: drives do not read their arguments."""


def _is_refused(each):
    """Format Error has no answer; our drives have no CAN XL."""
    if isinstance(each, Operation):
        return each.code is Code.CAN_XL_TRANSMIT
    code, stated = (int.from_bytes(each.data[at : at + 4], "little") for at in (0, 4))
    return code != Code.FORMAT_ERROR and not (stated == len(each.data) and (code, stated) in NOTIFICATIONS)


def test_can_fmu_passes_the_checks_of_fmpy_and_the_schema_of_its_terminals():
    path = build("3.0", bus=can_parameters(changed("virtual")))
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    schema = Path(fmpy.__file__).parent / "schema/fmi3/fmi3TerminalsAndIcons.xsd"
    etree.XMLSchema(file=str(schema)).assertValid(root)


def test_command_builds_the_can_fmu_of_a_configuration_and_refuses_another_protocol(tmp_path):
    done = CliRunner().invoke(fmu_build_command, ["--output", str(tmp_path), "--ls-bus"])
    assert done.exit_code == 0, done.output
    assert read_can_fmu(tmp_path / "virtual-can.fmu").countdown
    done = CliRunner().invoke(fmu_build_command, ["--ls-bus", "virtual-cia402"])
    assert "protocol cia402" in str(done.exception)
