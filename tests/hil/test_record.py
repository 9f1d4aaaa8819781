"""Recordings by a real recorder process: logs read by protobuf and the mcap library, and each way to end."""

import os
import resource
import signal
import stat
import subprocess
import sys
import time

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.errors import LogError
from drivers.frame_array import received_array
from drivers.protocol import Frame, Received
from drivers.signals import DriveFault, DriveState, Fault, Mode
from drivers.tick_columns import RECORDED, ROW
from hil.app import compose
from hil.app.configuration.configuration import load
from hil.app.replay import replay_log
from hil.app.sim import command
from hil.record import Recording, Scene
from hil.record.log import Log
from hil.record.mcap_file import being_written
from hil.record.salvage import salvage
from tests.hil.rewrite import mcap_summary
from tests.hil.samples import assert_same, random_rows, random_ticks, record

HEXAGON = [[np.cos(t), np.sin(t), 0.0] for t in np.arange(6) * np.pi / 3]
EPOCH_2000 = 946_684_800_000_000_000  # date -u -d 2000-01-01 +%s


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.mcap"


def decoded(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(c.topic, m, d) for _, c, m, d in reader.iter_decoded_messages(log_time_order=False)]


# -- what other programs read ----------------------------------------------------------------------------------


def test_the_mcap_library_accepts_the_file_its_index_and_checksums(path):
    files = [("legs.dbc", b"VERSION"), ("plant.fmu", bytes(300_000))]
    with Recording.start(path, configuration="a: 1\n", attachments=files, lockstep=True) as recording:
        record(recording, random_ticks(700))
        recording.event(5, "warning", "ä" * 100)
        summary = recording.close({"timing": {"p99_us": 12.5}})
    mcap = mcap_summary(path)
    assert mcap.statistics is not None
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert mcap.statistics.message_count == summary.messages == sum(1 for _ in reader.iter_messages())
        assert max(index.uncompressed_size for index in mcap.chunk_indexes) <= 256 * 1024 + 4096
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        assert attachments == {"config.yaml": b"a: 1\n", **dict(files)}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        assert metadata["summary"]["timing"] == '{"p99_us": 12.5}'
        assert {"numpy", "numba"} <= {k[8:] for k in metadata["environment"] if k.startswith("package.")}
        file.seek(0)
        sequential = NonSeekingReader(file, validate_crcs=True)
        assert sum(1 for _ in sequential.iter_messages()) == summary.messages
    assert summary.size_bytes == path.stat().st_size
    assert summary.complete


def test_a_viewer_gets_names_of_modes_flags_and_legs_and_the_units(path):
    rows = np.zeros(3, ROW)
    rows["tick"] = range(3)
    rows["mode"] = [Mode.TRACKING, 99, -1]
    rows["faults"] = [Fault.STALE | Fault.LAW, 0, -1]
    rows["drive_state"][:, 4] = [DriveState.FAULT, DriveState.RUN, 127]
    rows["drive_fault"][:, 2] = [DriveFault.SENSOR, 0x8130, 2**40]
    rows["q"][0, 5] = 1.25
    rows["p"][0, 1] = -0.5
    rows["R"][0, 2, 1] = 0.125
    with Recording.start(path, configuration="", lockstep=True) as recording:
        for row in rows:
            recording.tick(row, (), ())
    seen = [d for topic, _, d in decoded(path) if topic == "/tick"]

    def name(message, field):
        kind = message.DESCRIPTOR.fields_by_name[field].enum_type
        value = kind.values_by_number.get(getattr(message, field))
        return value.name if value else getattr(message, field)

    assert [name(d, "mode") for d in seen] == ["TRACKING", 99, "UNNAMED"]
    assert [d.mode_number for d in seen] == [5, 99, -1]
    flags = [[f.name for f, on in d.faults.ListFields() if on] for d in seen]
    assert flags == [["STALE", "LAW"], [], [fault.name for fault in Fault]]
    assert [name(d.drive_state, "leg_4") for d in seen] == ["FAULT", "RUN", "UNNAMED"]
    assert [name(d.drive_fault, "leg_2") for d in seen] == ["SENSOR", "UNNAMED", "UNNAMED"]
    assert [d.drive_fault_number.leg_2 for d in seen] == [4, 0x8130, 2**40]
    assert (seen[0].q.leg_5, seen[0].p.y, seen[0].R.zy) == (1.25, -0.5, 0.125)
    assert Log.open(path).rows().tobytes() == rows.tobytes()
    schema = next(s for s in mcap_summary(path).schemas.values() if s.name == "hil.Tick")
    file = FileDescriptorSet.FromString(schema.data).file[0]
    comments = {tuple(at.path): at.leading_comments for at in file.source_code_info.location}
    for number, field in enumerate(file.message_type[0].field):
        c = next(c for c in RECORDED if c.name == field.name.removesuffix("_number"))
        assert comments[4, 0, 2, number] == (f" {c.meaning} [{c.unit}]\n" if c.unit else f" {c.meaning}\n")


# -- no tick is lost in lockstep, none unnoticed in real time --------------------------------------------------


def test_lockstep_recordings_are_byte_equal_up_to_the_summary(tmp_path, capfd):
    contents = []
    for name in "ab":
        path = tmp_path / f"{name}.mcap"
        scene = Scene(HEXAGON, HEXAGON)
        with Recording.start(path, configuration="", lockstep=True, scene=scene, ring_ticks=512) as recording:
            for i, tick in enumerate(random_ticks(1500)):
                record(recording, [tick])
                if i % 400 == 7:
                    recording.event(i, "info", f"event {i} " * 20)
                    time.sleep(0.01)
        with path.open("rb") as file:
            messages = [(c.topic, m) for _, c, m in make_reader(file).iter_messages(log_time_order=False)]
        end = next(i.offset for i in mcap_summary(path).metadata_indexes if i.name == "summary")
        contents.append((messages, path.read_bytes()[:end]))
    assert len(contents[0][0]) > 5000
    assert contents[0] == contents[1]
    assert capfd.readouterr() == ("", "")  # random bits as poses included
    assert recording.process.returncode == 0


def test_lockstep_recording_does_not_stall_if_frames_fill_the_ring_before_rows(path):
    burst = tuple(Received(k, Frame(k, bytes([k % 256]))) for k in range(700))
    with Recording.start(path, configuration="", lockstep=True, ring_ticks=256) as recording:
        for row in random_rows(60):
            recording.tick(row, burst, ())
        for k in range(5000):
            recording.event(k, "info", "many events between two ticks")
    log = Log.open(path)
    assert all(tick.received == burst for tick in log.ticks())
    assert (log.summary.ticks, len(log.events())) == (60, 5000)


@pytest.mark.parametrize("frames", [0, 1, 33, 700])
def test_ticks_recorded_in_blocks_or_singly_give_the_same_log(tmp_path, frames):
    rows = random_rows(512)
    burst = received_array([Received(k, Frame(k, bytes([k % 256]))) for k in range(frames)])
    logs = [tmp_path / f"{name}.mcap" for name in "ab"]
    with Recording.start(logs[0], configuration="", lockstep=True, ring_ticks=256) as recording:
        for first in range(0, len(rows), 64):
            ends = frames * np.arange(1, 65)
            recording.ticks_of_items(np.array(rows[first : first + 64]), np.tile(burst, 64), ends)
    with Recording.start(logs[1], configuration="", lockstep=True, ring_ticks=256) as recording:
        for row in rows:
            recording.tick(row, burst, burst[:0])
    together, alone = ([(t.row.tobytes(), t.received) for t in Log.open(log).ticks()] for log in logs)
    assert len(together) == len(rows)
    assert together == alone


def test_real_time_drops_and_counts_ticks_if_the_recorder_is_slow(path):
    recording = Recording.start(path, configuration="", ring_ticks=256)
    os.kill(recording.process.pid, signal.SIGSTOP)
    ticks = random_ticks(300)
    try:
        begin = time.monotonic()
        record(recording, ticks)
        assert time.monotonic() - begin < 1.0
        assert recording.alive
        assert (recording.ticks, recording.dropped) == (256, 44)
    finally:
        os.kill(recording.process.pid, signal.SIGCONT)
    summary = recording.close()
    assert (summary.ticks, summary.dropped, summary.complete) == (256, 44, False)
    log = Log.open(path)
    assert log.metadata["summary"]["dropped"] == "44"
    assert_same(log.ticks(), ticks[:256])


# -- killed ----------------------------------------------------------------------------------------------------


def test_the_recorder_ignores_ctrl_c_and_termination_signals(path):
    recording = Recording.start(path, configuration="")
    record(recording, random_ticks(10))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(recording.process.pid, number)
    record(recording, random_ticks(10, seed=2))
    time.sleep(0.1)
    assert recording.alive
    assert recording.close().complete


PRODUCER = """
import os, sys, time
from hil.record import Recording
from tests.hil.samples import random_ticks, record
path, count, pace = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
ticks = random_ticks(count)
recording = Recording.start(path, configuration="kept: true\\n")
print(recording.process.pid, flush=True)
begin = time.monotonic()
for i, tick in enumerate(ticks):
    record(recording, [tick])
    if pace:
        time.sleep(max(0.0, begin + (i + 1) * pace - time.monotonic()))
        os.write(1, b"%d\\n" % (i + 1))
recording.event(3, "error", "the last words of the producer " * 5)
os.kill(os.getpid(), 9)
"""


def producer(path, count, pace=0.0):
    command = [sys.executable, "-c", PRODUCER, str(path), str(count), str(pace)]
    return subprocess.Popen(command, stdout=subprocess.PIPE)


def wait_closed(path, seconds=20.0):
    limit = time.monotonic() + seconds
    while True:
        try:
            return Log.open(path)
        except LogError:
            assert time.monotonic() < limit, "the log was not closed"
            time.sleep(0.05)


def test_a_killed_producer_leaves_a_complete_and_closed_log(path):
    child = producer(path, 2500)
    child.communicate(timeout=60)
    assert child.returncode == -signal.SIGKILL
    log = wait_closed(path)
    assert log.metadata["summary"]["closed"] == log.summary.closed == "producer died"
    assert log.configuration == "kept: true\n"
    assert_same(log.ticks(), random_ticks(2500))
    assert [event.text for event in log.events()] == ["the last words of the producer " * 5]


@pytest.mark.realtime
def test_killing_all_processes_at_once_loses_at_most_0_25_s(path, tmp_path):
    child = producer(path, 5000, pace=0.001)
    recorder = int(child.stdout.readline())
    time.sleep(1.35)
    os.kill(child.pid, signal.SIGKILL)
    os.kill(recorder, signal.SIGKILL)
    done = int(child.communicate(timeout=60)[0].split()[-1])
    report = salvage(path, tmp_path / "b.mcap")
    assert done > 500
    assert done - report.ticks <= 250  # at 1 kHz
    assert_same(Log.open(tmp_path / "b.mcap").ticks(), random_ticks(5000)[: report.ticks])


def test_a_real_time_run_continues_without_its_recorder(path):
    recording = Recording.start(path, configuration="", ring_ticks=256)
    record(recording, random_ticks(50))
    assert recording.alive
    assert being_written(path)
    os.kill(recording.process.pid, signal.SIGKILL)
    recording.process.wait()
    assert not recording.alive
    assert not being_written(path)
    record(recording, random_ticks(400))
    summary = recording.close({"a": "b"})
    assert not summary.complete
    assert "died" in summary.error
    assert summary.ticks + summary.lost + summary.dropped == 450
    assert summary.dropped >= 144


def test_a_lockstep_run_fails_without_its_recorder(path):
    recording = Recording.start(path, configuration="", lockstep=True, ring_ticks=256)
    os.kill(recording.process.pid, signal.SIGKILL)
    with pytest.raises(LogError, match="the recorder died"):
        record(recording, random_ticks(400))
    assert not recording.close().complete


# -- a full disk ---------------------------------------------------------------------------------------------

ROOM = 900_000
"""Bytes that the recorder is allowed to write."""


def lessen(recording, room=ROOM):
    """Limit the size of the recorder's files, which acts like a full disk."""
    resource.prlimit(recording.process.pid, resource.RLIMIT_FSIZE, (room, room))


def test_a_full_disk_closes_the_log_with_the_ticks_that_fit(tmp_path):
    path = tmp_path / "a.mcap"
    recording = Recording.start(path, configuration="kept: true\n")
    lessen(recording)
    record(recording, random_ticks(3000))
    summary = recording.close({"ending": "PARKED"})
    assert summary.error.startswith("disk_full: ")
    assert str(path) in summary.error
    assert (summary.gave_up, summary.complete) == (True, False)
    log = Log.open(path)
    assert 0 < summary.ticks == len(log.rows()) == log.summary.ticks
    assert summary.ticks + summary.lost + summary.dropped == 3000
    assert log.summary.closed == "disk_full"
    assert log.rows()["tick"].tolist() == list(range(summary.ticks))
    assert path.stat().st_size == summary.size_bytes <= ROOM


def test_a_disk_without_room_for_one_tick_leaves_no_log(tmp_path):
    recording = Recording.start(tmp_path / "a.mcap", configuration="")
    lessen(recording, (tmp_path / "a.mcap").stat().st_size + 10)
    record(recording, random_ticks(300))
    summary = recording.close()
    assert "disk_full" in summary.error
    assert (summary.ticks, summary.gave_up) == (0, True)
    assert not any(tmp_path.iterdir())


def test_a_simulation_on_a_full_disk_fails_and_its_log_replays(tmp_path, monkeypatch):
    def started(*arguments, **options):
        recording = compose.record(*arguments, **options)
        lessen(recording, 300_000)
        return recording

    monkeypatch.setattr(command, "record", started)
    summary = command.simulate(load("virtual"), log=tmp_path / "a.mcap", duration_s=0.3)
    assert not summary["success"]
    assert summary["trouble"].startswith("disk_full: ")
    assert summary["ticks"] > 100
    comparison, _ = replay_log(tmp_path / "a.mcap")
    assert (comparison.exact, comparison.ticks) == (True, summary["ticks"])


# -- the file --------------------------------------------------------------------------------------------------


def test_a_log_that_cannot_be_created_is_refused_with_the_reason(path, tmp_path):
    path.write_bytes(b"precious")
    with pytest.raises(LogError, match=r"a\.mcap exists and is never overwritten"):
        Recording.start(path, configuration="")
    assert path.read_bytes() == b"precious"
    with pytest.raises(LogError, match=r"No such file or directory: .*nowhere"):
        Recording.start(tmp_path / "nowhere" / "b.mcap", configuration="")
    with pytest.raises(LogError, match=r"b\.mcap: can_channels"):
        Recording.start(tmp_path / "b.mcap", configuration="", lockstep=True, can_channel="vcan\a")
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_without_ticks_gives_a_valid_log_that_obeys_the_umask(path):
    before = os.umask(0o027)
    try:
        Recording.start(path, configuration="x: 1\n").close()
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    log = Log.open(path)
    assert list(log.ticks()) == []
    assert log.summary.ticks == 0
    with path.open("rb") as file:
        assert list(make_reader(file, validate_crcs=True).iter_messages()) == []
