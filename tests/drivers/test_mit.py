"""MIT framing: the contract of each variant, its dialogue, frames of other libraries, and settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.mit.fields import VARIANTS, Ranges
from drivers.mit.protocol import ENABLE
from drivers.protocol import EXTENDED, Frame
from drivers.signals import Command, DriveMode, DriveState, Reaction
from drivers.transmission import Transmission
from hil.contracts.by_value import ByValue
from hil.contracts.loopback import SETUP, Ends
from hil.contracts.trouble import TroubleContract
from tests.drivers.motor_families import (
    ALL_NODES,
    GEAR,
    MIT_NODES,
    RANGES,
    MitProtocol,
    begun,
    mit,
    pack_command,
    robstride,
    unpack_command,
)

LEAD_m, NEWTONS = 0.1, 2 * np.pi / 0.1
# Twice a step, because the codecs truncate.
STEP_m, STEP_m_s = 2 * 191.0 / 65535 / (2 * np.pi) * LEAD_m, 2 * 800.0 / 4095 / (2 * np.pi) * LEAD_m
STEP_N = 2 * 288.0 / 4095 * NEWTONS
FINE_m_s, FINE_N = 2 * 800.0 / 65535 / (2 * np.pi) * LEAD_m, 2 * 288.0 / 65535 * NEWTONS


class MitInTrouble(TroubleContract):
    RESOLUTION = (STEP_m, STEP_m_s, STEP_N, STEP_N)
    LENGTHS, SPEED = (0.24, 3.26), 6.36
    """95.5 rad and 400 rad/s with 0.1 m per turn, less than a step from the ends."""
    VARIANT = ""

    @pytest.fixture
    def family(self):
        return mit(self.VARIANT)


class TestMiniCheetah(MitInTrouble):
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = TELLS_FAULTS = False
    RESTART, WRAPS, VARIANT = "nothing", True, "mini_cheetah"


class TestCubeMars(MitInTrouble):
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = CLEARS = False
    RESTART, VARIANT = "nothing", "cubemars"


class TestDamiao(MitInTrouble):
    TELLS_BOOT, VARIANT = False, "damiao"


class TestDamiaoOnCanFdAsDelivered(MitInTrouble):
    """All replies have identifier 0, the factory setting of MST_ID."""

    TELLS_BOOT = False

    @pytest.fixture
    def family(self):
        return MitProtocol("damiao", RANGES, MIT_NODES, 0, GEAR, "fd")


class TestRobStride(MitInTrouble):
    RESOLUTION = (STEP_m, FINE_m_s, FINE_N, FINE_N)
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = False

    @pytest.fixture
    def family(self):
        return robstride()


# the dialogue


BRAKES = SETUP._replace(reaction=Reaction.BRAKE)


def test_run_commanded_right_after_off_sends_enable_frames_again():
    protocol = mit("damiao")
    dialogue = begun(protocol, mode=DriveMode.RUN, ran=(True,) * 6)
    assert ENABLE not in {frame.data for frame in protocol.begin(dialogue, 1)}, (
        "the drive was disabled by itself"
    )
    for mode in (DriveMode.OFF, DriveMode.RUN):
        dialogue, _ = protocol.command(dialogue, Command(mode, np.zeros(6)), 1)
    assert {frame.data for frame in protocol.begin(dialogue, 2)} == {ENABLE}


def test_set_up_of_a_drive_with_different_ranges_fails_and_reports_the_range():
    ends = Ends(mit("damiao"))
    other = ByValue(MitProtocol("damiao", RANGES._replace(position=100.0), MIT_NODES, 16, GEAR))
    ends.dialogue = other.start(BRAKES)
    ends.protocol = other
    for _ in range(100):
        ends.step()
    assert not any(other.legs_set_up(ends.dialogue))
    assert other.set_up_lacks(ends.dialogue)[0] == "PMAX (register 21) is 95.5 in the drive, expected 100"


def test_range_without_exact_float32_value_is_confirmed_by_the_nearest_float32():
    near = RANGES._replace(position=95.3, velocity=400.1, torque=143.9)
    Ends(MitProtocol("damiao", near, MIT_NODES, 16, GEAR)).until_set_up()


# other people's code: tests/data/drives has the sources


DATA: dict[str, Any] = {
    name: json.loads((Path(__file__).parents[1] / f"data/drives/{name}.json").read_text(encoding="utf-8"))
    for name in ("mit", "damiao", "robstride")
}


def vectors(name: str, begins: str) -> list[Any]:
    found = [v for v in DATA[name]["vectors"] if v["what"].startswith(begins)]
    assert found, begins
    return found


def ranges(name: str, model: str) -> Ranges:
    """Ranges from a row with position, velocity, kp, kd, torque, or without gains."""
    p, v, *gains = DATA[name]["ranges"][model]
    return Ranges(p, v, gains[0] if name == "robstride" else gains[-1])


def frame(v: Any) -> Frame:
    return Frame(v["id"], bytes.fromhex(v["data"]), EXTENDED * v["extended"])


@pytest.mark.parametrize(
    ("variant", "model", "name"),
    [
        ("mini_cheetah", "mini_cheetah", "classic_V65"),
        ("cubemars", "AK80-9", "AK80-9_V50"),
        ("cubemars", "AK10-9", "AK10-9_V50"),
        ("cubemars", "AK80-6", "AK80-6_V76"),
        ("cubemars", "AK80-64", "AK80-64_V8"),
        *(("damiao", m, m) for m in ("DM4310", "DM8009", "DM4340", "DM6006", "DM4310_48V", "DM3507")),
        *(("robstride", m, m) for m in VARIANTS["robstride"].models),
    ],
)
def test_value_ranges_of_each_mit_drive_model_agree_with_other_libraries(variant, model, name):
    file = variant if variant in DATA else "mit"
    assert VARIANTS[variant].models[model] == pytest.approx(ranges(file, name), rel=1e-8)


def damiao(motor: str = "DM4310") -> MitProtocol:
    return MitProtocol("damiao", ranges("damiao", motor), ALL_NODES, 16, GEAR)


def test_damiao_special_frames_and_registers_agree_with_independent_libraries():
    protocol = damiao()
    start = protocol.start(BRAKES)
    # 0.1 s are 2000 steps of 50 us
    found = protocol.exchanges(BRAKES._replace(watchdog_s=0.1))[4]
    asked = {exchange.name.split()[0]: exchange.frames[0] for exchange in found}
    faulted = start._replace(mode=DriveMode.RESET, power=(DriveState.FAULT,) * 6)
    for sent, what in (
        (protocol.poll(start, 4), "disable"),
        (protocol.poll(start._replace(mode=DriveMode.RUN), 4), "enable"),
        (protocol.poll(faulted, 4), "clear error"),
        (asked["CTRL_MODE"], "write parameter CTRL_MODE"),
        (asked["PMAX"], "read parameter PMAX"),
        (asked["TMAX"], "read parameter TMAX"),
        (asked["TIMEOUT"], "write parameter TIMEOUT"),
    ):
        assert sent == frame(vectors("damiao", what)[0]), what


def test_robstride_special_frames_agree_with_independent_libraries():
    protocol = robstride()
    start = protocol.start(BRAKES)
    written, read = protocol.exchanges(BRAKES)[0][0].frames
    for sent, what in (
        (protocol.poll(start._replace(mode=DriveMode.RUN), 0), "type 3 enable"),
        (protocol.poll(start, 0), "type 4 disable"),
        (written, "type 18 write parameter run_mode 0"),
        (read, "type 17 read parameter run_mode"),
    ):
        assert [sent] == [frame(v) for v in vectors("robstride", what)]
    heard = protocol.hear(frame(vectors("robstride", "type 17 reply run_mode")[0]))
    assert heard.answer == (0x7005, 2.0)


@given(torque=st.floats(-20.0, 20.0), position=st.floats(-15.0, 15.0))
def test_torque_command_saturates_and_never_equals_an_enable_disable_or_clear_frame(torque, position):
    r = VARIANTS["damiao"].models["DM4310"]
    p, v, kp, kd, t = unpack_command(pack_command(position, 0.0, 0.0, 0.0, torque, r), r)
    assert 0.0 <= min(max(torque, -10.0), 10.0) - t < 20.0 / 4095 * (1 + 1e-9)
    assert 0.0 <= min(max(position, -12.5), 12.5) - p < 25.0 / 65535 * (1 + 1e-9)
    assert abs(v) <= 60.0 / 4095
    assert (kp, kd) == (0.0, 0.0)
    dialogue = damiao().start(BRAKES)._replace(mode=DriveMode.RUN, ran=(True,) * 6, torque=(torque,) * 6)
    assert damiao().poll(dialogue, 0).data[:7] != b"\xff" * 7


# settings


def made(layout: Any = "classic", **changes: Any) -> Any:
    values = {
        "protocol": "mit",
        "transmission": {"lead_m": 0.02, "offset_m": 0.3},
        "options": {"variant": "damiao", "model": "DM4310"},
        "force_limit_N": 5.0,
    }
    return build_protocol(BusSettings(layout=layout), DriveSettings.model_validate(values | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transmission": None}, r"drives\.transmission"),
        *(
            ({"layout": "fd", "options": {"variant": v, "model": next(iter(VARIANTS[v].models))}}, r"bus\.layout: .*given: fd")
            for v in ("mini_cheetah", "cubemars", "robstride")
        ),
        ({"options": {}}, "variant of protocol mit"),
        ({"options": {"variant": "damiao"}}, "model of protocol mit"),
        ({"options": {"variant": "mini_cheetah", "gain": 1}}, "given: gain"),
        ({"options": {"variant": "mini_cheetah", "torque_N_m": -1}}, "torque_N_m of protocol mit"),
        # replies with a drive's own identifier, or an invalid one
        ({"options": {"variant": "mini_cheetah", "host_id": 3}}, "host_id 3 a reply"),
        ({"options": {"variant": "cubemars", "model": "AK80-6", "host_id": 0x7FF}}, "host_id 2047 a reply"),
        ({"options": {"variant": "cubemars", "model": "AK80-6", "host_id": -1}}, "host_id -1 a reply"),
        ({"options": {"variant": "damiao", "model": "DM4310", "host_id": 1}}, "host_id 1 a reply"),
        ({"options": {"variant": "damiao", "model": "DM4310", "host_id": 0x7FE}}, "host_id 2046 a reply"),
        *(
            ({"options": {"variant": "robstride", "model": "rs-02", "host_id": host}}, f"host_id .*given: {host}")
            for host in (0, 127, 256)
        ),
        *(
            ({"node_ids": [1, 2, 3, 4, 5, node]}, rf"node_ids\[5\]: .* variant damiao: 1 to 15, .*given: {node}")
            for node in (0, 16)
        ),
        *(
            ({"node_ids": [1, 2, 3, 4, 5, 128], "options": {"variant": v, "model": next(iter(VARIANTS[v].models))}},
             rf"node_ids\[5\]: .* variant {v}: 1 to 127, .*given: 128")
            for v in ("mini_cheetah", "cubemars", "robstride")
        ),
        # 4000 N x 20 mm / 2 pi = 12.73 N m
        ({"force_limit_N": 4000.0}, r"4000 N need 12\.73 N m"),
    ],
)  # fmt: skip
def test_setting_that_an_mit_variant_does_not_support_is_refused_with_its_key(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        made(**changes)


@pytest.mark.parametrize(
    ("variant", "model", "host", "last"),
    [
        ("mini_cheetah", "mini_cheetah", 0, 127),
        ("cubemars", "AK80-6", 0, 127),
        ("damiao", "DM4340", 16, 15),
        ("robstride", "rs-03", 253, 127),
    ],
)
def test_configured_nodes_ranges_and_identifiers_reach_each_mit_codec(variant, model, host, last):
    nodes = [7, 2, 3, 4, 1, last]
    options = {"variant": variant, "model": model}
    delivered = VARIANTS[variant].models[model]
    keys = {"position_rad": "position", "velocity_rad_s": "velocity", "torque_N_m": "torque"}
    for key, field in keys.items():
        found = made(node_ids=nodes, options=options | {key: 33.5}).ranges
        assert found == delivered._replace(**{field: 33.5})
    for host_id, other in ((None, host), (200, 200)):
        protocol = made(node_ids=nodes, options=options | ({} if host_id is None else {"host_id": host_id}))
        frames = protocol.traits.cyclic_frames
        if variant == "robstride":
            assert [frame.id for frame in protocol.traits.emergency_stop] == [
                4 << 24 | other << 8 | n for n in nodes
            ]
        else:
            assert [frame.id for frame in frames[:6]] == nodes
            assert [frame.id for frame in frames[6:]] == [other + n * (variant == "damiao") for n in nodes]
    assert len(frames) == 12
    made(node_ids=nodes, options=options | {"host_id": 255 if variant == "robstride" else 0x7FE - 15})


@pytest.mark.parametrize("variant", ["mini_cheetah", "cubemars", "damiao"])
def test_range_of_reported_leg_lengths_follows_from_the_position_field(variant):
    """12.5 rad on a pulley of 20 mm are 0.25 m, in both directions from the motor's zero."""
    gear = Transmission(TransmissionSettings(pulley_radius_m=0.02, offset_m=[1.0, 1.1, 1.2, 1.3, 1.4, 1.5]))
    ranges, host = RANGES._replace(position=12.5), 16 if variant == "damiao" else 0
    shortest, longest = MitProtocol(variant, ranges, MIT_NODES, host, gear).traits.reported_lengths
    assert shortest == pytest.approx([0.75, 0.85, 0.95, 1.05, 1.15, 1.25])
    assert longest == pytest.approx([1.25, 1.35, 1.45, 1.55, 1.65, 1.75])
