"""Rows of the plant's log in real time: none before what waits is answered, none lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.arrays import Rows
from drivers.frame_array import NO_FRAMES, received_array, received_frames, sent_array, sent_frames
from drivers.protocol import Frame, Received
from hil.app.compose import build_nodes, build_protocol
from hil.app.configuration.configuration import load
from hil.app.plant_rows import SILENT_NS, PlantRows
from tests.drivers.legs_frames import opening

MS = 1_000_000


class Log:
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
    log = Log()
    yield nodes, log, PlantRows(log.tick, nodes), lambda tick: opening(protocol, tick)[0]
    plant.close()


def heard_at(served, t_ns):
    nodes, _, rows, sync = served
    heard = [Received(t_ns, sync(t_ns // MS))]
    sent = [frame for _, frame in nodes.step(t_ns, heard)]
    rows.take(received_array(heard), sent_array(sent), t_ns)
    return heard, sent


def test_what_came_while_drives_had_to_answer_is_in_one_row_with_every_frame(served):
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


def test_drives_that_have_to_answer_all_the_time_are_recorded_all_the_same(served):
    _, log, rows, _ = served
    for t_ns in range(MS, 13 * MS, MS):
        heard_at(served, t_ns)
        rows.write(t_ns, answered=False)
    assert [int(row["t_ns"]) for row, _, _ in log.rows] == [MS + SILENT_NS, 2 * MS + 2 * SILENT_NS]


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize(
    ("rate_m_s", "moves"), [(0.0, False), (0.9e-3, False), (-0.9e-3, False), (0.3, True), (-0.3, True)]
)
def test_a_platform_that_moves_is_recorded_while_nobody_asks_and_one_at_rest_is_not(
    served, monkeypatch, leg, rate_m_s, moves
):
    nodes, log, rows, _ = served
    real = nodes.snapshot()

    def snapshot():
        rate = np.zeros(6)
        rate[leg] = rate_m_s
        return real._replace(rate=rate, t_ns=now_ns)

    now_ns = MS
    monkeypatch.setattr(nodes, "snapshot", snapshot)
    heard = [Received(MS, Frame(1, b""))]
    rows.take(received_array(heard), sent_array([Frame(2, b"")]), MS)
    rows.write(MS)
    assert len(log.rows) == 1
    for now_ns in range(2 * MS, 22 * MS, MS):
        rows.take(NO_FRAMES, NO_FRAMES, now_ns)
        rows.write(now_ns)
    assert [int(row["t_ns"]) for row, _, _ in log.rows[1:]] == (
        [MS + k * SILENT_NS for k in range(1, 5)] if moves else []
    )
