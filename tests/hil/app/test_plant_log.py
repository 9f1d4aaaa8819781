"""The row that `hil plant` records."""

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from hil.app.compose import build_nodes
from hil.app.configuration.configuration import load
from hil.app.plant_columns import PLANT
from hil.app.plant_rows import plant_row
from hil.record import Recording
from hil.record.log import Log


def test_the_plants_truth_comes_back_from_its_log_under_the_names_of_legs_and_axes(tmp_path):
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
