"""Each stage of a tick reads and fills only its own columns.

A stage runs twice from the same state: on a tick as it is, and on one with poison in every column that it may
not read. Own columns and results must agree to the bit, and all other columns must stay unchanged. This fails
for a law that takes tau for its last force, a safety that reads tau_law, a filter that takes q for the
measured length, or a decoder that leaves the age of a silent leg unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.frame_array import received_array
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Received
from drivers.sensing.settings import TrackerSettings
from drivers.signals import INVALID, DriveFault, DriveState, Mode
from drivers.tick_columns import COLUMNS, Record, copy_of, part
from hil.app.configuration.configuration import load
from hil.app.derive_encoder_limits import encoder_limits
from hil.config.estimation import FusionSettings
from hil.config.limits import LimitSettings
from hil.contracts.drives_end import reports
from hil.contracts.messages import Status
from hil.contracts.records import altered, arrived, record_of
from hil.estimation.external_wrench import ExternalWrench
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_layout import LegErrors
from hil.estimation.observer import WrenchObserver
from hil.estimation.pose import Estimator
from hil.estimation.predictor import Predictor, ahead
from hil.loop.reference import fill_reference
from hil.robot.dynamics import Model
from hil.robot.force_path import ForcePath
from hil.safety import Safety
from hil.safety.certificate import Watch
from tests import sensor_samples
from tests.drivers.legs_frames import SETUP, one_feedback
from tests.hil.control.test_laws import BOOK, PLATFORM, SETTINGS, make, sample
from tests.sensor_samples import Readings, Sample

ODD = 0x5EED_5EED_5EED_5EED | 1
MS = 1_000_000
POSE = ("p", "R", "twist")
STATE = ("q", "dq", *POSE, "J")
LAWS_READ = (*part("estimate", "reference"), "shortfall")
SAFETY_READS = (
    *(name for name in part("input") if name not in {"compute_ns", "frames_crc32"}),
    *("mode", "tau_asked", "probe_force", "rejected", "foreign", "doubled", "altered", "drive_state"),
    *("age", "counted_age", "length", "rate", "drive_force"),
    *(*STATE, "fk_residual", "hop", "condition", "unseen", "fusion_faults", "fusion_warnings"),
    *("p_d", "R_d", "twist_d", "dtwist_d", "q_d", "dq_d", "ddq_d"),
)
MOVED_OR_DOUBTED = ("legs_moved", "legs_doubted", "doubt", "doubt_value", "doubt_limit", "encoder_share")
LYAPUNOV = ("lyapunov", "lyapunov_rate", "lyapunov_bound", "lyapunov_share")


def poisoned(tick: Record, *kept: str) -> Record:
    """Tick with nan, or a large odd number, in all columns except those kept."""
    poison = {name: np.nan if c.type is float else ODD for name, c in COLUMNS.items() if name not in kept}
    return altered(tick, **poison)


def bits(tick: Record, name: str) -> bytes:
    return tick[name].tobytes()


Stage = Callable[[Record], Any]


def follow(
    make_stage: Callable[[], Stage], ticks: list[Record], reads: tuple[str, ...], owns: tuple[str, ...]
):
    """Run one stage through the ticks and another one through poisoned ticks, and compare."""
    plain, blind = make_stage(), make_stage()
    seen = set()
    for tick in ticks:
        clean, dirty = copy_of(tick), poisoned(tick, *reads)
        before = copy_of(dirty)
        assert repr(plain(clean)) == repr(blind(dirty))
        differing = {name for name in owns if bits(clean, name) != bits(dirty, name)}
        assert not differing, "what the stage fills depends on columns that are not its own"
        filled = {name for name in COLUMNS if bits(tick, name) != bits(clean, name)}
        written = filled | {name for name in COLUMNS if bits(before, name) != bits(dirty, name)}
        assert written <= set(owns), "the stage writes into columns that are not its own"
        seen |= filled
    assert seen, "the stage has done nothing"


def moving(**columns: Any) -> list[Record]:
    """Ticks close to the book's path, with a value in every column that a stage may read."""
    chance, ticks = np.random.default_rng(11), []
    for k, case in enumerate(BOOK["states"][4:12]):
        tick = arrived(PLATFORM, sample(case), 1e-3 * k, tick=k, t_ns=k * MS, lateness_ns=k, recorder_alive=1)
        tick["q"] += chance.normal(0.0, 1e-4, 6)
        tick["dq"] += chance.normal(0.0, 1e-3, 6)
        tick["p"] += chance.normal(0.0, 1e-4, 3)
        tick["length"], tick["rate"] = tick["q"], tick["dq"]
        tick["age"] = tick["counted_age"] = [0, 0, 0, 0, 0, k % 2]
        tick["drive_state"], tick["drive_force"] = DriveState.RUN, chance.normal(3600.0, 100.0, 6)
        tick["mode"], tick["condition"], tick["fk_residual"] = Mode.TRACKING, 5.0 + k, 1e-9 * k
        tick["wrench"], tick["shortfall"] = chance.normal(0.0, 50.0, 6), chance.normal(0.0, 50.0, 6)
        tick["tau_asked"] = chance.normal(3600.0, 500.0, 6)
        ticks.append(altered(tick, **columns))
    return ticks


@pytest.mark.parametrize("layout", ["classic", "fd", "ideal"])
def test_decoder_reads_only_frames_and_the_last_measurement(layout):
    protocol = LegsProtocol(layout, (1, 2, 3, 4, 5, 6))
    frames = [
        one_feedback(protocol, leg, 1.5 + 0.1 * leg, 0.25, 100.0 * leg, DriveState.RUN, 8) for leg in range(4)
    ]
    frames.append(one_feedback(protocol, 4, 1.5, 0.25, 100.0, DriveState.RUN | INVALID, 8))
    frames += reports(protocol, Status(2, DriveState.FAULT, DriveFault.ESTOP))
    run = received_array([Received(1000 + k, frame) for k, frame in enumerate(frames)])
    kept = ("tick", "length", "rate", "drive_force", "drive_state", "drive_fault", "age")
    last = record_of(**dict(zip(kept, (7, 1.0, 0.5, 20.0, DriveState.READY, 1, 3), strict=True)))
    lasts = [last, poisoned(last, *kept, "blind")]
    end = protocol.controller_end(SETUP)
    stages = iter([lambda tick, last=last: end.take(run, last, tick) for last in lasts])
    follow(lambda: next(stages), [record_of(tick=8)], ("tick",), part("measurement"))


def test_pose_estimator_reads_only_leg_lengths_and_rates():
    ticks, first = moving(), sample(BOOK["states"][4])
    owns = (*POSE, "J", "fk_iterations", "fk_residual", "hop", "condition")
    follow(lambda: Estimator(PLATFORM, first.p, first.R).update, ticks, ("q", "dq"), owns)
    lost = altered(ticks[0], q=np.nan)
    follow(lambda: Estimator(PLATFORM, first.p, first.R).update, [lost], ("q", "dq"), owns)


def fusion():
    """Filter with a tracker, started on the book's path."""
    settings = FusionSettings(may_lose_legs=[5])
    first, tracker = sample(BOOK["states"][4]), TrackerSettings()
    errors = LegErrors(length_std_m=3e-7, rate_std_m_s=1e-3)
    found = FusedEstimator(PLATFORM, Model(PLATFORM), settings, errors, tracker, None, 1e-3)
    found.start(-1, -MS, first.p, first.R)
    return found


def test_fusion_filter_reads_only_the_measurement():
    def make_stage():
        found = fusion()

        def run(tick):
            number = int(tick["tick"])
            samples = (Sample(number - 1, 0.3e-3, (0.1, 0.2, 1.1, 0.0, 0.0, 0.0)),) if number % 2 else ()
            sensor_samples.update(
                found, tick, None, Readings(tracker=samples), np.full(6, 3600.0), np.zeros(6)
            )

        return run

    reads = (
        *("tick", "t_ns", "lateness_ns", "latch_ns", "length", "rate", "drive_force", "drive_state"),
        *("age", "blind"),
    )
    owns = (*STATE, "fk_residual", "condition", *part("fusion"), "counted_age")
    follow(make_stage, moving(), (*reads, "innovation_tracker", "tracker"), owns)


def test_leg_reference_reads_only_the_pose_sample():
    owns = ("p_d", "R_d", "twist_d", "dtwist_d", "q_d", "dq_d", "ddq_d")
    there = sample(BOOK["states"][20])
    follow(lambda: lambda tick: fill_reference(PLATFORM, there, tick), moving(), (), owns)


@pytest.mark.parametrize("name", SETTINGS)
def test_control_law_reads_only_estimate_reference_and_force_shortfall(name):
    follow(lambda: make(name).effort, moving(), LAWS_READ, ("tau_law",))


@pytest.mark.parametrize("pose", [0.0, 1.0])
def test_safety_reads_neither_the_laws_force_nor_the_sent_force(pose):
    table = np.zeros((12, 6))
    table[2:5], table[5], table[6], table[8] = 4.0, 1e3, 1e-6, 1.0
    table[11] = [pose, 0.0, 1.0, 2.0, 1.0, 1e-3]
    limits = LimitSettings(
        force_N=3700.0, force_step_N=3000.0, force_window_N=1e5, speed_m_s=9.0, deceleration_m_s2=9.0,
        following_error_m=9.0,
    )  # fmt: skip

    encoders = encoder_limits(load("virtual"), 1e3)

    def make_stage():
        return Safety(limits, 0.5, 9.0, 1e3, 1e5, watch=Watch(table, 1), encoders=encoders).judge

    off = moving(mode=Mode.IDLE)
    follow(make_stage, moving() + off[:2] + moving(), SAFETY_READS, ("tau", *MOVED_OR_DOUBTED, *LYAPUNOV))


def test_the_predictor_reads_only_the_state_and_the_load():
    def make_stage():
        predictor = Predictor(Model(PLATFORM), ForcePath(1e-3, 0.5e-3, 0.8e-3), 0.5e-3)

        def run(tick):
            ahead(predictor.record, 1, tick)
            predictor.path.send(np.full(6, 3000.0))

        return run

    follow(make_stage, moving(), ("tick", *POSE, "wrench"), STATE)


@pytest.mark.parametrize("fusing", [False, True])
def test_the_observer_needs_only_pose_twist_and_drives(fusing):
    def make_stage():
        observer = WrenchObserver(Model(PLATFORM), ForcePath(1e-3, 0.0, 0.8e-3), 20.0)
        wrench = ExternalWrench(observer, None, 1e-3)

        def run(tick):
            wrench.fill(tick, fusing=fusing)
            observer.path.send(np.full(6, 3000.0))

        return run

    reads = ("tick", "drive_state", *POSE, *(["legs_used"] if fusing else []))
    follow(make_stage, moving(legs_used=0b111111), reads, ("wrench", "wrench_sensor"))
