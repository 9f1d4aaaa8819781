"""`hil sim`: simulates both ends of the bus in lockstep, as fast as the machine allows."""

import contextlib
import hashlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError
from drivers.files import open_regular
from drivers.frame_array import NO_FRAMES
from drivers.signals import Mode
from hil.app.compose import attachments, build_cycle, build_nodes, record
from hil.app.configuration.bus_budget import loads
from hil.app.configuration.changes import without_operator
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import law_figures
from hil.app.configuration.fault_words import show_fault
from hil.app.homing.keeper import Keeper
from hil.app.log_budget import make_room, needed_bytes
from hil.app.output import after_run, end_record, fail, fault_story, leaving, log_path, warn
from hil.app.plant_rows import PLANT, plant_row, plant_warnings
from hil.app.replay import measured
from hil.app.sim.build import build_lockstep
from hil.app.sim.commands import CommandScript, TimedCommand
from hil.app.sim.lockstep import Lockstep
from hil.loop.clock import collector_paused
from hil.loop.console import REFUSED
from hil.loop.cycle import Cycle
from hil.loop.homing import LastPose
from hil.loop.run_end import Ending
from hil.loop.tick_row import Given, Ticks
from hil.record import Recording
from hil.record.log import plant_log_beside
from hil.record.recording import RecorderEndedError
from hil.record.schema import RUN
from hil.signals import SetPoint
from hil.trajectory.sampled import read_poses
from plant_fmu.config import FmuPlant
from plant_fmu.faults.plan import FaultPlan

LONG_S = 600.0
"""Length of a reference above which a shorter `--duration` is proposed."""
UNHEARD = "no commands are given: operator.start, deadman_s and stays are left out"


class Script:
    """Set-points of a CSV file, each given in the first tick at or after its time along the live reference.

    Mutable state: the number of set-points given. Raises ConfigurationError for a reference that accepts no
    set-points, and for an invalid file.
    """

    def __init__(self, c: Configuration, cycle: Cycle, path: Path) -> None:
        c.require_live()
        t, chi = read_poses(path, at_least=1)
        self._t = t.tolist()
        self._setpoints = [SetPoint(*words) for words in chi.tolist()]
        self._cycle = cycle
        self._given = 0

    @property
    def left(self) -> int:
        """Number of set-points not yet given."""
        return len(self._t) - self._given

    def __call__(self, tick: int) -> tuple[SetPoint, ...]:
        """Set-points that are due in a tick."""
        if self._cycle.mode is not Mode.TRACKING:
            return ()
        now, first = self._cycle.motion.time(tick), self._given
        while self._given < len(self._t) and self._t[self._given] <= now:
            self._given += 1
        return tuple(self._setpoints[first : self._given])


def run_identity(
    c: Configuration,
    duration_s: float | None,
    faults: FaultPlan | None,
    setpoints: Path | None,
    commands: Sequence[TimedCommand],
    last_pose: LastPose | None = None,
) -> str:
    """Identity of a simulation, hexadecimal: a digest of all its inputs.

    It contains neither time nor randomness: a repeated run has the same identity and the same rows.
    `last_pose`: the leg lengths that the controller assumes; their date is left out.
    """
    plan = faults or FaultPlan()
    said = [list(c.plant.faults) if c.plant else [], list(plan.faults), plan.seed, plan.gravity.tolist()]
    digest = hashlib.sha256(f"{c.text}\0{duration_s!r}\0{said!r}\0{list(commands)!r}".encode())
    for name, content in attachments(c):
        digest.update(f"\0{name}\0".encode() + content)
    if setpoints is not None:
        digest.update(b"\0" + setpoints.read_bytes())
    if last_pose is not None:
        for stood in (last_pose.length, last_pose.limit_m, last_pose.step_m, last_pose.m_per_turn):
            digest.update(b"\0" + stood.tobytes())
    files = [] if c.plant is None or c.plant.drives.fmu is None else list(c.plant.drives.fmu.path)
    if c.plant is not None and isinstance(c.plant.model, FmuPlant):
        files.append(c.plant.model.path)
    for file in files:
        with open_regular(c.folder / file) as fmu:
            digest.update(hashlib.file_digest(fmu, "sha256").digest())
    return digest.hexdigest()[:32]


def _record_plant(c: Configuration, path: Path, run: str) -> Recording:
    """Start the recorder of the plant's true state: one row for each tick, no frames."""
    return Recording.start(
        path, configuration=c.text, table=PLANT, metadata={"kind": "plant", RUN: run}, lockstep=True,
        can_channel=[each.channel for each in c.bus.buses], ring_ticks=c.recording.ring_ticks,
    )  # fmt: skip


def simulate(
    configuration: Configuration,
    *,
    log: Path | None = None,
    duration_s: float | None = None,
    check_replay: bool = True,
    faults: FaultPlan | None = None,
    live: bool = False,
    setpoints: Path | None = None,
    commands: Sequence[TimedCommand] = (),
    plant_log: bool = False,
) -> dict[str, Any]:
    """Simulate the configuration in lockstep, record it, and return the summary (key `success`).

    live: draw a status line on standard error, and propose a shorter duration for a long reference.
    setpoints: CSV file of poses for a live reference, at times along it.
    commands: operator commands at simulated seconds. Without commands the run waits for no operator; where it
        would wait for more commands than are given, it parks.
    plant_log: record the plant's true state in a second log, as `hil plant` does.

    Raises ConfigurationError for a configuration that cannot run, PlantError: the plant does not start.
    """
    c = configuration if commands else without_operator(configuration)
    c.require("sim")
    assert c.plant is not None
    rate = c.loop.rate_Hz
    bus_load = loads(c.bus, c.drives, c.sensors, rate, c.folder)
    watchdog_s = c.drives.watchdog_ms * 1e-3
    keeper = Keeper(c, emulated=True)
    cycle = build_cycle(c, rate, watchdog_s, last_pose=keeper.last_pose)
    if cycle.parts.trajectory.duration_s is None and duration_s is None:
        raise ConfigurationError(
            f"{c.source}: reference: it has no end, and a simulation needs one: set duration_s or "
            "periods, or call with --duration"
        )
    whole_s = cycle.parts.trajectory.duration_s
    if live and duration_s is None and whole_s is not None and whole_s > LONG_S:
        warn(
            f"hil: the reference takes {whole_s:.0f} s of simulated time; --duration 60 stops after a minute"
        )
    script = None if setpoints is None else Script(c, cycle, setpoints)
    operator = CommandScript(commands, rate)
    path = log_path(c.recording.folder, c.name, log)
    removed = make_room(c, needed_bytes(c, cycle.parts.trajectory.duration_s, duration_s), log)
    truth_path = plant_log_beside(path)
    if plant_log:
        log_path(c.recording.folder, c.name, truth_path)
    with contextlib.ExitStack() as stack:
        nodes, physics = build_nodes(c, faults)
        stack.callback(physics.close)
        run = run_identity(c, duration_s, faults, setpoints, commands, keeper.last_pose)
        lockstep = build_lockstep(c, cycle, nodes, attended=bool(commands))
        recording = stack.enter_context(record(c, cycle, path, "sim", live=live, lockstep=True, run=run))
        truth = stack.enter_context(_record_plant(c, truth_path, run)) if plant_log else None
        stack.enter_context(collector_paused())
        if removed:
            recording.event(0, "info", f"removed for recording.budget_GB: {', '.join(removed)}")
        if c is not configuration:
            recording.event(0, "info", UNHEARD)
        for fault in c.plant.faults:
            recording.event(0, "info", f"to be injected: {show_fault(fault)}")
        stack.callback(keeper.close)
        keeper.begin(cycle)
        begun = time.perf_counter()
        ending = _run_to_end(lockstep, (recording, truth, path), duration_s, script, operator)
        wall = time.perf_counter() - begun
        warnings = plant_warnings(physics, recording, lockstep.tick * lockstep.period_ns)
        with leaving(lambda: f"{after_run(ending)}; its log: {path}"):
            recorder = recording.close(end_record(ending, ending.trouble))
            lost = recorder.error or ("" if truth is None else truth.close().error)
    result: dict[str, Any] = {
        "success": ending.success and not lost,
        "kind": "sim",
        "trouble": "; ".join(filter(None, (ending.trouble, lost))) or None,
        "story": fault_story(ending),
        "configuration": c.source,
        "log": str(path),
        **({"removed_logs": removed} if removed else {}),
        **({"plant_log": str(truth_path)} if plant_log else {}),
        "rate_Hz": rate,
        **law_figures(c.controller, cycle.parts.law),
        **bus_load,
        **warnings,
        "wall_s": wall,
    }
    with leaving(lambda: f"{after_run(ending)}; its log is whole: {path}"):
        rows = measured(result, path, lost, check_replay=check_replay and not lost)
        if rows is not None and len(rows):
            result["real_time_factor"] = (len(rows) - 1) / rate / wall
        result |= keeper.summary(cycle)
        fail(result, keeper.trouble)
        result["recorder_cpu_s"] = recorder.recorder_cpu_s
        injected, unmet = nodes.schedule.begun(nodes.now_ns), nodes.waiting
        late = [fault for fault in c.plant.faults if fault not in injected and fault not in unmet]
        struck = {"injected": injected, "mode_not_reached": unmet, "time_not_reached": late}
        result |= {key: [show_fault(fault) for fault in which] for key, which in struck.items() if which}
        if commands:
            said = {"given": len(commands) - operator.left, "refused": operator.refused}
            result["commands"] = said | {"not_reached": operator.left}
        if script is not None and script.left:
            result["setpoints"] = result.get("setpoints", {}) | {"not_reached": script.left}
        result["success"] &= result.get("replay", {}).get("agrees", True)
    return result


def _run_to_end(
    lockstep: Lockstep,
    logs: tuple[Recording, Recording | None, Path],
    duration_s: float | None,
    setpoints: Script | None,
    script: CommandScript,
) -> Ending:
    """Simulate to the end of the run or of its recorder; after Ctrl-C close the log, then raise."""
    recording, truth, path = logs
    cycle = lockstep.cycle

    def take(ticks: Ticks, new: slice, given: Given) -> None:
        rows, frames, ends = ticks.recorded(new)
        if any(given):
            recording.tick(rows[0], frames, NO_FRAMES, given.operator, given.setpoints, given.orders)
        else:
            recording.ticks_of_items(rows, frames, ends)
        if truth is not None:
            truth.tick(plant_row(int(rows["tick"][0]), lockstep.nodes.snapshot()), (), ())

    def said(tick: int) -> Given:
        given = script(tick)
        return given if setpoints is None else given._replace(setpoints=setpoints(tick) + given.setpoints)

    def answered(operator: Sequence[str], orders: Sequence[str], answers: Sequence[str]) -> None:
        if refused := script.answered(operator, orders, answers):
            recording.event(lockstep.tick * lockstep.period_ns, "warning", REFUSED + "; ".join(refused))

    try:
        ending = lockstep.run(
            duration_s,
            None,
            recording.event,
            said,
            take=take,
            silent=script.silent if setpoints is None and truth is None else lambda _: 1,
            armed=not script.arms,
            over=lambda: script.over,
            answered=answered,
        )
        if ending.trouble:
            recording.event(lockstep.tick * lockstep.period_ns, "error", ending.trouble)
    except RecorderEndedError:
        return Ending(cycle.mode, cycle.faults, "", lockstep.tick)
    except KeyboardInterrupt:
        recording.close({"ending": cycle.mode.name, "reason": "interrupted", "faults": int(cycle.faults)})
        t_s = 1e-9 * lockstep.tick * lockstep.period_ns
        raise KeyboardInterrupt(f"at {t_s:.3f} s of simulated time; the log until then: {path}") from None
    return ending
