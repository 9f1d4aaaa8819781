"""The row that `hil plant` records."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.arrays import Rows
from drivers.frame_array import received_array, received_frames, sent_array, sent_frames
from drivers.protocol import Frame, Received
from hil.app.compose import build_nodes, build_protocol
from hil.app.configuration.configuration import load
from hil.app.plant_columns import PLANT
from hil.app.plant_rows import PlantRows, plant_row
from hil.record import Recording
from hil.record.log import Log
from tests.drivers.legs_frames import opening


def test_the_truth_of_the_plant_comes_back_from_its_log(tmp_path):
    nodes, physics = build_nodes(load("virtual"))
    nodes.start(0)
    nodes.step(5_000_000, ())
    snapshot = nodes.snapshot()
    physics.close()
    with Recording.start(tmp_path / "a.mcap", configuration="", table=PLANT, lockstep=True) as recording:
        recording.tick(plant_row(0, snapshot), (), ())
    row = Log.open(tmp_path / "a.mcap").rows()[0]
    assert snapshot.truth is not None
    assert row["length"].tobytes() == snapshot.length.tobytes()
    assert row["R"].tobytes() == np.ascontiguousarray(snapshot.truth.R).tobytes()
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        seen = next(d for _, _, _, d in reader.iter_decoded_messages(["/plant"]))
    assert seen.length.leg_3 == snapshot.length[3]
    assert (seen.p.z, seen.R.yz) == (snapshot.truth.p[2], snapshot.truth.R[1, 2])
    assert seen.drive_state_number.leg_5 == snapshot.state[5]


MS = 1_000_000


class Kept:
    """Keeps what it is given."""

    def __init__(self) -> None:
        self.rows: list[tuple[Any, list[Received], list[Frame]]] = []

    def tick(self, row: Any, heard: Rows, sent: Rows) -> None:
        self.rows.append((row, [*received_frames(heard)], [*sent_frames(sent)]))


@pytest.fixture
def served():
    """Six drives that nobody has asked, their log and its rows, and the SYNC of a tick."""
    c = load("virtual")
    nodes, plant = build_nodes(c)
    protocol = build_protocol(c)
    nodes.start(0)
    log = Kept()
    yield nodes, log, PlantRows(log.tick, nodes), lambda tick: opening(protocol, tick)[0]
    plant.close()


def heard_at(served, t_ns):
    nodes, _, rows, sync = served
    heard = [Received(t_ns, sync(t_ns // MS))]
    sent = [frame for _, frame in nodes.step(t_ns, heard)]
    rows.take(received_array(heard), sent_array(sent), t_ns)
    return heard, sent


def test_frames_that_wait_for_answers_share_one_row(served):
    _, log, rows, _ = served
    first, second = heard_at(served, MS), heard_at(served, 2 * MS)
    rows.write(2 * MS, answered=False)
    assert log.rows == []
    rows.write(2 * MS)
    ((row, heard, sent),) = log.rows
    assert heard == first[0] + second[0]
    assert sent == first[1] + second[1]
    assert len(sent) >= 12
    assert (row["syncs"], row["t_ns"], row["tick"]) == (2, 2 * MS, 0)
