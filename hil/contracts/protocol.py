"""Contract of every drive protocol: both ends exchange frames over a bus without bit time.

The test class of a protocol gives `family` and `RESOLUTION`; see test_protocols.py.
"""

from __future__ import annotations

import pickle

import cantools
import numpy as np
import pytest

from drivers.can.bus_time import frame_bits
from drivers.errors import ProtocolError
from drivers.family import Family
from drivers.frame_array import NO_FRAMES, received_array
from drivers.protocol import BUS, ERROR, EXTENDED, REMOTE, Frame, Received
from drivers.signals import LEGS, NEVER, Command, DriveMode, DriveState
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.drives_end import answers
from hil.contracts.loopback import (
    FORCE,
    LENGTH,
    PATIENCE,
    PERIOD_NS,
    RATE,
    SETUP,
    Ends,
    Twice,
    at_tick,
    reaction_of,
    shapes,
)
from hil.contracts.messages import Sync
from plant_fmu.faults.kinds import DriveSilence, FramesLoss


class ProtocolContract:
    """Contract suite of a drive protocol: inherit it and set the attributes of this class."""

    RESOLUTION: tuple[float, float, float | None, float]
    """Resolution of length m, rate m/s, force N in the feedback (None: no force) and force in the command.
    Twice the step if a codec truncates."""
    READS_RATES = True
    """False for a protocol that computes rates from lengths: the lengths are constant in these tests."""
    SETS_WATCHDOG = True
    """True if the dialogue, or each command, sets the drive's own watchdog."""
    TELLS_BOOT = True
    """True if the feedback of a drive shows that it has lost its set-up."""

    @pytest.fixture
    def family(self) -> Family:
        raise NotImplementedError

    @pytest.fixture
    def protocol(self, family) -> ByValue:
        return ByValue(family)

    def test_an_end_restored_to_an_earlier_state_repeats_its_frames(self, family):
        ends = Ends(Twice(family))
        ends.running()
        assert pickle.loads(pickle.dumps(ends.dialogue)) == ends.dialogue

    def test_start_up_sets_up_every_drive_and_then_sends_nothing(self, protocol):
        ends = Ends(protocol)
        assert not any(protocol.legs_set_up(ends.dialogue))
        assert all(protocol.set_up_lacks(ends.dialogue))
        ends.until_set_up()
        assert protocol.set_up_lacks(ends.dialogue) == ("",) * LEGS
        drives = ends.nodes._drives
        if self.SETS_WATCHDOG:
            assert drives.seen.watchdog_ns.tolist() == [50_000_000] * LEGS
        assert drives.seen.reaction.tolist() == [reaction_of(protocol)] * LEGS
        assert [ends.step() for _ in range(60)] == [()] * 60

    def test_force_of_ready_drives_on_closed_brakes_matches_the_traits(self, protocol):
        ends = Ends(protocol)
        ends.until_set_up()
        for _ in range(4):
            ends.step(Command(DriveMode.READY, FORCE), set_up=False)
        there = ends.nodes.snapshot()
        assert ends.measurement["drive_state"].tolist() == [DriveState.READY] * LEGS
        assert there.brake.tolist() == [1.0] * LEGS
        assert bool(there.force.any()) == protocol.traits.force_on_brakes

    def test_forces_carried_at_rest_equal_the_forces_at_the_drives(self, protocol):
        ends = Ends(protocol)
        ends.running()
        for _ in range(4):
            ends.step(Command(DriveMode.RUN, FORCE))
        taken = ends.nodes.snapshot().command
        assert protocol.carried(ends.dialogue, FORCE) == pytest.approx(taken, rel=1e-6, abs=2.0)

    def test_no_tick_has_more_set_up_frames_than_stated(self, protocol):
        ends = Ends(protocol)
        counts = [len(ends.step()) for _ in range(PATIENCE)]
        assert max(counts) == protocol.traits.set_up_frames
        for frame in ends.set_up:
            frame_bits(len(frame.data), frame.flags)
            assert len(frame.data) <= 8, "the bus time of `hil check` assumes it"

    def test_a_silent_drive_does_not_delay_the_set_up_of_the_others(self, protocol):
        ends = Ends(protocol, DriveSilence(leg=3))
        ends.until_set_up([0, 1, 2, 4, 5])
        assert not protocol.legs_set_up(ends.dialogue)[3]
        assert [bool(lack) for lack in protocol.set_up_lacks(ends.dialogue)] == [leg == 3 for leg in range(6)]

    def test_start_up_completes_although_frames_are_lost(self, protocol):
        ends = Ends(protocol, FramesLoss(probability=0.3, for_s=0.2))
        ends.until_set_up()
        assert ends.nodes._drives.seen.configured.tolist() == [True] * LEGS

    def test_a_second_start_up_sets_up_drives_that_stayed_powered(self, protocol):
        ends = Ends(protocol)
        ends.until_set_up()
        ends.dialogue = protocol.start(SETUP._replace(watchdog_s=0.08, reaction=reaction_of(protocol)))
        assert not any(protocol.legs_set_up(ends.dialogue))
        ends.until_set_up()
        if self.SETS_WATCHDOG:
            assert ends.nodes._drives.seen.watchdog_ns.tolist() == [80_000_000] * LEGS

    def test_a_drive_that_lost_its_set_up_is_set_up_again(self, protocol):
        ends = Ends(protocol)
        ends.until_set_up()
        drives = ends.nodes._drives
        if not self.TELLS_BOOT:  # then its silence shows it
            ends.step()
            ends.received.clear()
            m = at_tick(ends.tick + 40)
            dialogue = protocol.decode(ends.dialogue, NO_FRAMES, ends.measurement, m)
            assert not any(protocol.legs_set_up(dialogue))
            return
        drives.seen.state[2], drives.seen.configured[2] = DriveState.BOOT, False
        for _ in range(2 * LEGS + 2):
            ends.step()
        ends.until_set_up()
        assert drives.seen.configured.tolist() == [True] * LEGS

    def test_start_up_sends_nothing_to_running_drives(self, protocol):
        ends = Ends(protocol)
        ends.running()
        run = Command(DriveMode.RUN, FORCE)
        setup = SETUP._replace(reaction=reaction_of(protocol))
        ends.dialogue, _ = protocol.command(protocol.start(setup), run, ends.tick)
        for _ in range(PATIENCE):
            assert ends.step(run) == ()
        assert ends.measurement["drive_state"].tolist() == [DriveState.RUN] * LEGS

    @pytest.mark.parametrize("watchdog_s", [0.0, -1.0, 1e6, np.nan])
    def test_a_watchdog_time_out_of_range_is_refused(self, protocol, watchdog_s):
        with pytest.raises(ProtocolError, match="watchdog"):
            protocol.start(SETUP._replace(watchdog_s=watchdog_s))

    def test_a_command_reaches_the_drives_exactly_at_the_stated_delay(self, protocol):
        ends = Ends(protocol)
        ends.running(np.zeros(LEGS))
        heard = []
        for k in range(3):
            ends.step(Command(DriveMode.RUN, FORCE if k == 0 else 2.0 * FORCE), set_up=False)
            heard.append(ends.nodes.snapshot().command)
        allowed = self.RESOLUTION[3] / 2 * (1 + 1e-6)
        delay = protocol.traits.command_delay_ticks
        assert delay in (0, 1)
        assert all(np.abs(force).max() <= allowed for force in heard[:delay])
        np.testing.assert_allclose(heard[delay], FORCE, rtol=0, atol=allowed)
        np.testing.assert_allclose(heard[delay + 1], 2.0 * FORCE, rtol=0, atol=allowed)

    def test_the_stated_delay_decides_which_frames_carry_the_command(self, protocol):
        ends = Ends(protocol)
        ends.running()
        before = ends.protocol.begin(ends.dialogue, 1000)
        dialogue, sent = protocol.command(ends.dialogue, Command(DriveMode.RUN, -FORCE), 1000)
        after = protocol.begin(dialogue, 1000)
        assert (bool(sent), before == after) == (
            (False, False) if protocol.traits.command_delay_ticks else (True, True)
        )

    def test_feedback_is_fresh_and_carries_length_rate_force_and_state(self, protocol):
        ends = Ends(protocol)
        ends.running()
        m, resolution = ends.measurement, self.RESOLUTION
        assert m["age"].tolist() == [0] * LEGS
        assert m["rejected"] == 0
        assert m["blind"].tolist() == [False] * LEGS
        np.testing.assert_allclose(m["length"], LENGTH, rtol=0, atol=resolution[0] / 2 * (1 + 1e-6) + 1e-12)
        np.testing.assert_allclose(m["rate"], RATE, rtol=0, atol=resolution[1] / 2 * (1 + 1e-6))
        if resolution[2] is not None:
            total = (resolution[2] + resolution[3]) / 2 * (1 + 1e-6)
            np.testing.assert_allclose(m["drive_force"], FORCE, rtol=0, atol=total)

    def test_readings_and_commands_are_exact_to_the_stated_resolution(self, protocol):
        ends = Ends(protocol)
        ends.running()
        stated, m, rounding = protocol.traits.resolution.at(1e9 / PERIOD_NS), ends.measurement, 1.0 + 1e-6
        assert (np.abs(m["length"] - LENGTH) <= stated.length * rounding + 1e-12).all()
        if self.READS_RATES:
            assert (np.abs(m["rate"] - RATE) <= stated.rate * rounding + 1e-6).all()
        assert (np.abs(ends.nodes.snapshot().command - FORCE) <= stated.force * rounding + 1e-3).all()
        assert (stated.length <= self.RESOLUTION[0] + 1e-6).all()
        assert (stated.force <= self.RESOLUTION[3] * rounding).all()

    def test_each_feedback_frame_is_fresh_only_in_its_own_tick(self, protocol):
        ends = Ends(protocol)
        ends.until_set_up()
        for _ in range(20):
            ends.step()
            begun = ends.tick * PERIOD_NS
            fresh = [each for each in ends.received if protocol.fresh(each, ends.tick, begun)]
            assert {protocol.awaited(each.frame) for each in fresh} == protocol.traits.feedback_ids
            assert not any(protocol.fresh(each, ends.tick + 1, begun + PERIOD_NS) for each in fresh)
            assert not any(protocol.fresh(Received(begun, frame), ends.tick, begun) for frame in ends.opening)

    def test_only_the_feedback_of_the_silent_drive_ages(self, protocol):
        ends = Ends(protocol, DriveSilence(leg=2, at_s=1.0))
        ends.until_set_up()
        while ends.measurement["age"][2] == 0:
            ends.step()
        ages = [ends.measurement["age"].tolist()]
        for _ in range(2):
            ends.step()
            ages.append(ends.measurement["age"].tolist())
        assert ages == [[0, 0, n, 0, 0, 0] for n in (1, 2, 3)]

    def test_drives_without_any_feedback_have_age_never(self, protocol):
        m = at_tick(5)
        protocol.decode(Ends(protocol).dialogue, NO_FRAMES, new_record(), m)
        assert m["age"].tolist() == [NEVER] * LEGS
        assert (m["tick"], m["rejected"]) == (5, 0)

    def test_an_emergency_stop_faults_all_drives_with_a_fault_code(self, protocol):
        ends = Ends(protocol)
        ends.running()
        ends.step(Command(DriveMode.RUN, FORCE), set_up=False, first=protocol.traits.emergency_stop)
        for _ in range(ends.report_ticks - 1):
            ends.step()
        stopped = DriveState.FAULT if protocol.traits.stop_latches else DriveState.OFF
        assert ends.measurement["drive_state"].tolist() == [stopped] * LEGS
        assert (ends.measurement["drive_fault"] != 0).all() == protocol.traits.stop_latches
        assert ends.nodes.snapshot().brake.all()

    def test_a_reset_of_the_stated_length_clears_the_faults(self, protocol):
        ends = Ends(protocol)
        ends.until_set_up()
        ends.step(first=protocol.traits.emergency_stop)
        for _ in range(2):
            ends.step()
        for _ in range(protocol.traits.reset_ticks):
            ends.step(Command(DriveMode.RESET, np.zeros(LEGS)))
        for _ in range(8):
            ends.step()
        assert ends.measurement["drive_state"].tolist() == [DriveState.OFF] * LEGS
        assert not ends.measurement["drive_fault"].any()

    def test_the_frames_of_a_tick_match_the_bus_budget(self, protocol):
        ends = Ends(protocol)
        ends.running()
        ends.step(Command(DriveMode.RUN, FORCE), set_up=False)
        answers = [
            each.frame
            for each in ends.received
            if protocol.awaited(each.frame) in {*map(protocol.awaited, protocol.traits.feedbacks)}
        ]
        named = not protocol.traits.shares_identifiers
        found = shapes((*ends.opening, *ends.sent, *answers), named=named)
        assert found == shapes(protocol.traits.cyclic_frames, named=named)

    def test_every_frame_is_a_valid_can_frame(self, protocol):
        ends = Ends(protocol)
        ends.step()
        stop = protocol.traits.emergency_stop
        for frame in (*protocol.traits.cyclic_frames, *ends.step(), *stop):
            frame_bits(len(frame.data), frame.flags)
            assert 0 <= frame.id <= (0x1FFF_FFFF if frame.flags & EXTENDED else 0x7FF)
            assert frame.bus == 0

    def test_sender_and_receivers_of_every_frame_are_known(self, protocol):
        ends = Ends(protocol)
        ends.until_set_up()
        ends.step()
        assert {protocol.sender(each.frame) for each in ends.received} == set(range(LEGS))
        stop = protocol.traits.emergency_stop
        assert {protocol.sender(frame) for frame in (*ends.opening, *ends.sent, *stop)} == {-1}
        for frames in (ends.opening or ends.sent, stop):
            assert {leg for frame in frames for leg in protocol.addressed(frame)} == set(range(LEGS))

    @pytest.mark.parametrize("flag", [EXTENDED, REMOTE, ERROR, BUS, 255 * BUS])
    def test_frames_with_another_flag_or_bus_are_ignored(self, protocol, flag):
        ends = Ends(protocol)
        ends.until_set_up()
        ends.step()
        strange = [each._replace(frame=_other(each.frame, flag)) for each in ends.received]
        m = at_tick(ends.tick + 1)
        nothing = protocol.decode(ends.dialogue, NO_FRAMES, ends.measurement, at_tick(ends.tick + 1))
        dialogue = protocol.decode(ends.dialogue, received_array(strange), ends.measurement, m)
        assert (dialogue, m["rejected"], m["age"].tolist()) == (nothing, 0, [1] * LEGS)
        assert not any(protocol.fresh(each, ends.tick, 0) for each in strange)
        memory = protocol.power_up()
        for frame in (*ends.opening, *ends.sent, *protocol.traits.emergency_stop):
            assert protocol.parse(memory, _other(frame, flag)) == (memory, ())

    def test_both_ends_survive_frames_of_any_length_and_content(self, protocol):
        ends = Ends(protocol)
        stop = protocol.traits.emergency_stop
        seen = {frame.id: frame for frame in (*protocol.traits.cyclic_frames, *stop)}
        for _ in range(40):
            ends.step()
            seen |= {each.frame.id: each.frame for each in ends.received}
            seen |= {frame.id: frame for frame in ends.set_up}
        generator = np.random.default_rng(1)
        memory, dialogue, m = protocol.power_up(), ends.dialogue, ends.measurement
        for tick in range(ends.tick + 1, ends.tick + 40):
            broken = [
                frame._replace(data=generator.bytes(int(generator.integers(0, 65))))
                for frame in seen.values()
            ]
            for frame in broken:
                memory, _ = protocol.parse(memory, frame)
            last, m = m, at_tick(tick)
            dialogue = protocol.decode(dialogue, received_array([Received(0, f) for f in broken]), last, m)
            assert np.isfinite([*m["length"], *m["rate"]]).all()
            assert m["rejected"] > 0

    @pytest.mark.parametrize("force", [[np.nan] * 6, [0, 0, np.inf, 0, 0, 0], [1e12] * 6, [0.0] * 5])
    def test_a_force_that_is_invalid_or_out_of_range_is_refused(self, protocol, force):
        with pytest.raises(ProtocolError, match="N"):
            protocol.command(Ends(protocol).dialogue, Command(DriveMode.RUN, np.array(force)), 0)

    def test_a_drive_refuses_to_send_a_nan_reading(self, protocol):
        state = np.zeros(LEGS, np.int64)
        with pytest.raises(ProtocolError, match="not a number"):
            answers(protocol, Sync(0), LENGTH, np.full(LEGS, np.nan), FORCE, state)

    def test_the_dbc_file_of_a_protocol_can_be_read(self, protocol):
        if protocol.traits.database is not None:
            name, text = protocol.traits.database
            assert name.endswith(".dbc")
            cantools.database.load_string(text, "dbc")


def _other(frame: Frame, flag: int) -> Frame:
    """Frame with one flag inverted."""
    return frame._replace(flags=frame.flags ^ flag)
