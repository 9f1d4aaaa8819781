"""What the rows of motor protocols take of a configuration, and the words with which they refuse the rest."""

from __future__ import annotations

from typing import Any

import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.motor_settings import Options, refuse_torque, unwatched
from drivers.signals import Reaction
from drivers.transmission import Transmission


def options(*known: str, **given: Any) -> Options:
    drives = DriveSettings(transmission=TransmissionSettings(lead_m=0.5), options={})
    return Options(BusSettings(), drives.model_copy(update={"options": given}), "kite", "fd", known)


def refused(text: str) -> Any:
    return pytest.raises(ConfigurationError, match=f"^{text}$")


def test_unknown_keys_are_named_with_the_known_ones():
    options("a", "b", a=1)
    with refused("drives.options: protocol kite has a, b, given: c, d"):
        options("a", "b", c=1, a=2, d=3)
    with refused("drives.options: protocol kite has none, given: c"):
        options(c=1)


def test_a_choice_is_one_of_the_words_and_the_only_one_where_nothing_is_given():
    assert options("a", a="y").choice("a", ("x", "y")) == "y"
    assert options("a").choice("a", ("x",)) == "x"
    for given, shown in (({}, "nothing"), ({"a": "z"}, "z"), ({"a": 3}, "3")):
        with refused(f"drives.options: a of protocol kite: allowed: one of x, y, given: {shown}"):
            options("a", **given).choice("a", ("x", "y"))


def test_a_positive_number_is_above_nothing_and_no_word_and_no_truth():
    assert (options("a", a=2).positive("a", 1.0), options("a").positive("a", 1.5)) == (2.0, 1.5)
    assert isinstance(options("a", a=2).positive("a", 1.0), float)
    for wrong in (0, -1.0, True, "2", float("nan")):
        with refused(f"drives.options: a of protocol kite: allowed: a number greater than 0, given: {wrong}"):
            options("a", a=wrong).positive("a", 1.0)


def test_a_whole_number_is_one_and_no_truth():
    assert (options("a", a=-2).whole("a", 1), options("a").whole("a", 7)) == (-2, 7)
    for wrong in (True, 2.0, "2"):
        with refused(f"drives.options: a of protocol kite: allowed: a whole number, given: {wrong}"):
            options("a", a=wrong).whole("a", 1)


def test_a_layout_and_a_transmission_that_are_not_there_are_asked_for():
    with refused("bus.layout: allowed with kite: classic, given: fd"):
        Options(BusSettings(layout="fd"), DriveSettings(), "kite", "classic", ())
    assert options().transmission.m_per_turn.tolist() == [0.5] * 6
    with refused(
        "drives.transmission: protocol kite speaks of motors; state lead_m or .*, sign and offset_m"
    ):
        Options(BusSettings(), DriveSettings(), "kite", "fd", ())


@pytest.mark.parametrize("leg", range(6))
def test_the_leg_that_needs_most_torque_decides_and_is_named_where_legs_are_unlike(leg):
    leads = [0.1] * 6
    leads[leg] = 0.2
    # F l / (2 pi eta): 100 N x 0.2 m / (2 pi 0.8) = 3.979 N m
    unlike = Transmission(TransmissionSettings(lead_m=leads, efficiency=0.8, sign=[1, -1, 1, -1, 1, -1]))
    refuse_torque(unlike, 100.0, 3.98, "kite")
    text = rf"drives.force_limit_N: 100 N need 3.979 N m of the motor of leg {leg} \(31.42 N a N m without losses\), "
    with refused(text + "kite carries up to 3.97 N m: lower it, or change gear_ratio or lead_m"):
        refuse_torque(unlike, 100.0, 3.97, "kite")
    alike = Transmission(TransmissionSettings(lead_m=0.2, efficiency=0.8))
    with refused(r"drives.force_limit_N: 100 N need 3.979 N m of the motor \(31.42 .*"):
        refuse_torque(alike, 100.0, 3.97, "kite")


def test_a_force_that_needs_just_the_torque_of_the_field_is_taken():
    unit = Transmission(TransmissionSettings(lead_m=1.0))
    needed = float((100.0 / unit.N_per_Nm)[0])
    refuse_torque(unit, 100.0, needed, "kite")
    with refused("drives.force_limit_N: .*"):
        refuse_torque(unit, 100.0, needed * (1 - 1e-12), "kite")


def test_drives_without_a_watchdog_keep_their_last_torque():
    assert unwatched("kite").startswith("drives.watchdog_ms: kite has no watchdog that is set from here; ")


# rows


def made(name: str, layout: Any, **values: Any) -> Any:
    known: dict[str, Any] = {
        "transmission": {"lead_m": 0.02},
        "force_limit_N": 5,
        "node_ids": [7, 2, 3, 4, 5, 6],
    }
    drives = DriveSettings.model_validate(known | {"protocol": name} | values)
    return build_protocol(BusSettings(layout=layout), drives)


def test_a_moteus_is_made_with_its_nodes_the_controllers_number_its_torque_and_what_it_does_in_silence():
    for mode, reaction in (("stopped", Reaction.BRAKE), ("zero_velocity", Reaction.DAMP)):
        protocol = made("moteus", "fd", options={"timeout_mode": mode, "host_id": 9, "torque_N_m": 1.5})
        assert protocol.traits.feedback_ids == {node << 8 | 9 for node in (7, 2, 3, 4, 5, 6)}
        assert (protocol.traits.reactions, protocol.torque_limit) == ((reaction,), 1.5)
    plain = made("moteus", "fd", options={"timeout_mode": "stopped"})
    assert (plain.torque_limit, plain.traits.emergency_stop[0].id) == (1e4, 0x8007)
    with refused("bus.layout: allowed with moteus: fd, given: classic"):
        made("moteus", "classic", options={"timeout_mode": "stopped"})


def test_an_odrive_is_made_with_its_nodes_and_timers():
    protocol = made("odrive", "classic", heartbeat_ms=200, watchdog_ms=30, options={"encoder_msg_rate_ms": 4})
    assert protocol.traits.feedback_ids == {node << 5 | 9 for node in (7, 2, 3, 4, 5, 6)}
    assert protocol.traits.unasked_s == pytest.approx(0.004)
    assert protocol.patience_ticks(101.0) == 61
    assert made("odrive", "classic").traits.unasked_s == pytest.approx(0.01)
    assert (
        made("odrive", "classic", heartbeat_ms=250, options={"encoder_msg_rate_ms": 10_000}).traits.unasked_s
        == 10.0
    )
    with refused("drives.heartbeat_ms: allowed with odrive: up to 250, as .* is enabled, given: 250.5"):
        made("odrive", "classic", heartbeat_ms=250.5)
    with refused("drives.force_limit_N: .* N m of the motor .* odrive carries up to 10000 N m: .*"):
        made("odrive", "classic", transmission={"lead_m": 2000.0}, force_limit_N=60)


@pytest.mark.parametrize(
    ("variant", "model", "host"),
    [("mini_cheetah", "mini_cheetah", 0), ("cubemars", "AK80-6", 0), ("damiao", "DM4340", 16)],
)
def test_a_drive_with_mit_framing_is_made_with_its_variant_model_and_the_identifier_of_its_replies(
    variant, model, host
):
    protocol = made("mit", "classic", options={"variant": variant, "model": model, "torque_N_m": 9.0})
    assert (protocol.ranges.torque, protocol.ranges.position) == (9.0, 12.5)
    replies = protocol.traits.cyclic_frames[6:]
    assert [frame.id for frame in replies] == [host + node * (host > 0) for node in (7, 2, 3, 4, 5, 6)]
    other = made("mit", "classic", options={"variant": variant, "model": model, "host_id": 64})
    assert other.traits.cyclic_frames[6].id == 64 + 7 * (host > 0)
    with refused(f"drives.force_limit_N: .* mit, variant {variant}, carries up to .*"):
        made("mit", "classic", options={"variant": variant, "model": model}, force_limit_N=60_000)


def test_a_robstride_is_made_with_its_controllers_number():
    protocol = made("mit", "classic", options={"variant": "robstride", "model": "rs-03"})
    assert (protocol.traits.emergency_stop[0].id, protocol.torque_limit) == (4 << 24 | 253 << 8 | 7, 60.0)
    named = made("mit", "classic", options={"variant": "robstride", "model": "rs-03", "host_id": 200})
    assert named.traits.emergency_stop[0].id == 4 << 24 | 200 << 8 | 7


@pytest.mark.parametrize(
    ("variant", "model", "message"),
    [
        ("damiao", "DM4310", "host_id 0 makes replies come on 0x7, .*"),
        ("robstride", "rs-02", "host_id of protocol mit: allowed: a whole number of 128 to 255, given: 0"),
    ],
)
def test_a_number_of_0_that_is_given_is_not_taken_for_none(variant, model, message):
    with refused(f"drives.options: {message}"):
        made("mit", "classic", options={"variant": variant, "model": model, "host_id": 0})
    assert made("odrive", "classic", options={"encoder_msg_rate_ms": 0}).traits.unasked_s == 0.0
    assert made("odrive", "classic").traits.unasked_s == 0.01
