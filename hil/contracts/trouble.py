"""Contract of every drive protocol under faults: field limits, broken frames, power, silence.

The test class of a family inherits `TroubleContract` and sets the attributes in which it differs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.family import Family
from drivers.protocol import Frame, Received
from drivers.signals import LEGS, Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import ByValue
from hil.contracts.loopback import (
    CLIPS_N,
    FORCE,
    LEG,
    LENGTH,
    OFF,
    PERIOD_NS,
    READY,
    RESET,
    RUN,
    Line,
    most_force,
)
from hil.contracts.messages import Configure, Status, announce
from hil.contracts.protocol import ProtocolContract
from plant_fmu.drives.drive_rules import fail
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import DriveReset, DriveSilence

EXAMPLES = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""Settings of a property test, without a deadline, so that a busy machine is not a failure."""


LONG_SEEDS = [pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 12)]


class TroubleContract(ProtocolContract):
    """Contract suite of a drive protocol under faults: inherit it and set what differs from the defaults."""

    LENGTHS: tuple[float, float]
    """Smallest and largest length in the feedback, m."""
    SPEED: float
    """Largest rate in the feedback, m/s, in both directions."""
    RELATIVE = 1e-12
    """Relative resolution of lengths, rates and forces; 6e-8 for single precision."""
    ENDS = True
    """True if values beyond the field saturate or give no reading; False for single precision, which has
    no end."""
    WRAPS = False
    """True if values beyond the field wrap round, as in the maker's firmware."""
    WATCHED = True
    """True if the drive reacts by itself to a silent controller."""
    RESTART = "boot"
    """Behaviour of a drive that restarts in motion: `boot` state, `nothing` (no force), or `obeys` again."""
    TELLS_FAULTS = True
    LATCHES = True
    """True if a fault stays until a reset; False if it ends when the drive is switched off."""
    CLEARS = True
    """True if a reset clears a fault; False if the drive needs to be switched off and on."""
    MOST_N = CLIPS_N
    """Force at which the drive clips a command, N."""
    BEATS: str | None = None
    """Purpose of the drive's own heartbeat: `state`, `set-up` or `nothing`; None without heartbeat."""
    OTHER = 0x40
    """Bit of a CAN identifier whose inversion makes a frame foreign to the protocol."""

    def beat_ids(self, protocol: Family) -> set[int]:
        """CAN identifiers of the drives' heartbeats."""
        return set()

    def ids_of(self, protocol: Family, leg: int) -> set[int]:
        """Keys by which `awaited` recognises the cyclic feedback frames of a leg."""
        cyclic = protocol.traits.cyclic_frames
        return {protocol.awaited(frame) for frame in cyclic if protocol.sender(frame) == leg}

    # limits of fields

    def test_every_allowed_force_up_to_the_largest_reaches_the_drive(self, protocol):
        line, most = Line(protocol), min(most_force(protocol), self.MOST_N)
        line.running()
        allowed = self.RESOLUTION[3] / 2 * (1 + 1e-6)

        def arrives(force: list[float]) -> None:
            for _ in range(1 + protocol.traits.command_delay_ticks):
                line.step(Command(DriveMode.RUN, np.array(force)), set_up=False)
            np.testing.assert_allclose(line.nodes.snapshot().command, force, rtol=self.RELATIVE, atol=allowed)

        for sign in (1.0, -1.0):
            arrives([sign * most] * LEGS)
        one = st.floats(-most, most)
        EXAMPLES(given(st.lists(one, min_size=LEGS, max_size=LEGS))(arrives))()

    def test_every_length_and_rate_in_range_reaches_the_controller(self, protocol):
        line = Line(protocol)
        line.until_set_up()

        def arrives(length: list[float], rate: list[float]) -> None:
            line.plant.length, line.plant.rate = np.array(length), np.array(rate)
            line.step()
            line.step()
            m = line.measurement
            assert m["age"].tolist() == [0] * LEGS
            assert not m["blind"].any()
            spans = np.array([np.abs(self.LENGTHS).max(), self.SPEED])
            half = np.array(self.RESOLUTION[:2]) / 2 * (1 + 1e-6) + self.RELATIVE * spans
            np.testing.assert_allclose(m["length"], length, rtol=0, atol=half[0])
            np.testing.assert_allclose(m["rate"], rate, rtol=0, atol=half[1])

        for length, rate in ((self.LENGTHS[0], -self.SPEED), (self.LENGTHS[1], self.SPEED)):
            arrives([length] * LEGS, [rate] * LEGS)
        lengths, rates = st.floats(*self.LENGTHS), st.floats(-self.SPEED, self.SPEED)
        places, motions = (st.lists(one, min_size=LEGS, max_size=LEGS) for one in (lengths, rates))
        EXAMPLES(given(places, motions)(arrives))()

    @pytest.mark.parametrize("end", [0, 1])
    def test_values_beyond_a_field_saturate_or_give_no_reading(self, protocol, end):
        line = Line(protocol)
        line.until_set_up()
        low, high = self.LENGTHS
        beyond = 3.0 * (high - low) * (1 if end else -1) + (high if end else low)
        line.plant.length = np.full(LEGS, beyond)
        line.plant.rate = np.full(LEGS, 50.0 * self.SPEED * (1 if end else -1))
        for _ in range(3):
            line.step()
        m = line.measurement
        assert np.isfinite([*m["length"], *m["rate"]]).all()
        if not self.ENDS:
            np.testing.assert_allclose(m["length"], beyond, rtol=1e-6)
            return
        if self.WRAPS:
            assert (np.abs(m["length"] - beyond) > high - low).all()
            return
        read = (m["age"] == 0) & (m["blind"] == 0)
        at_end = m["length"] >= high - 1e-6 if end else m["length"] <= low + 1e-6
        assert (at_end | ~read).all(), m["length"]
        assert (m["rate"][read] * (1 if end else -1) >= self.SPEED * (1 - 1e-6)).all(), m["rate"]

    # frames

    @pytest.mark.parametrize("what", ["cut", "strange", "late"])
    def test_a_truncated_late_or_foreign_frame_is_not_feedback(self, protocol, what):
        line = Line(protocol)
        line.running()
        before = line.measurement["length"].copy()
        line.plant.length = LENGTH + 0.01
        here = self.ids_of(protocol, LEG)

        def spoil(frames: list[Received]) -> list[Received]:
            return [
                self._spoiled(each, what) if protocol.awaited(each.frame) in here else each for each in frames
            ]

        line.to_hear = spoil
        for k in range(1, 4):
            line.step(RUN, set_up=False)
            m = line.measurement
            assert (m["age"][LEG] >= 1) if what == "late" else (m["age"][LEG] == k)
            assert m["age"].tolist()[:LEG] == [0] * LEG
            assert m["foreign"] == m["doubled"] == 0
            if what == "strange":
                assert m["rejected"] == 0
            elif what == "cut":
                assert m["rejected"] >= 1
                assert m["length"][LEG] == before[LEG]
        line.to_hear = list
        line.step(RUN, set_up=False)
        assert line.measurement["age"].tolist() == [0] * LEGS
        assert line.states() == [DriveState.RUN] * LEGS

    def _spoiled(self, each: Received, what: str) -> Received:
        if what == "late":
            return each._replace(t_ns=each.t_ns - PERIOD_NS)
        if what == "cut":
            return each._replace(frame=each.frame._replace(data=each.frame.data[:3]))
        return each._replace(frame=each.frame._replace(id=each.frame.id ^ self.OTHER))

    def test_a_duplicated_answer_is_harmless(self, protocol):
        line = Line(protocol)
        line.running()
        line.to_hear = lambda frames: [each for each in frames for _ in range(2)]
        for _ in range(3):
            line.step(RUN, set_up=False)
            m = line.measurement
            assert m["age"].tolist() == [0] * LEGS
            assert m["doubled"] == m["foreign"] == 0

    @pytest.mark.parametrize("what", ["cut", "strange"])
    def test_only_truncated_commands_are_counted_and_no_foreign_one_is_obeyed(self, protocol, what):
        line = Line(protocol)
        line.running()
        before = line.nodes.snapshot()

        def spoil(frames: Sequence[Frame]) -> list[Frame]:
            if what == "strange":
                return [frame._replace(id=frame.id ^ self.OTHER) for frame in frames]
            return [frame._replace(data=frame.data[:3]) for frame in frames if len(frame.data) > 3]

        line.to_obey = spoil
        for _ in range(2):
            line.step(Command(DriveMode.RUN, -FORCE), set_up=False)
        after = line.nodes.snapshot()
        assert after.command.tolist() == before.command.tolist()
        assert (after.rejected > before.rejected) == (what == "cut")
        line.to_obey = list
        for _ in range(1 + protocol.traits.command_delay_ticks):
            line.step(Command(DriveMode.RUN, -FORCE), set_up=False)
        np.testing.assert_allclose(line.nodes.snapshot().command, -FORCE, rtol=0, atol=self.RESOLUTION[3])

    # power

    def powers_up(self, protocol: ByValue, order: Sequence[int], gap_s: float) -> None:
        late: list[Fault] = []
        for k, leg in enumerate(order):
            at_s = 0.02 + gap_s * k
            late += [DriveSilence(leg=leg, at_s=0.0, for_s=at_s), DriveReset(leg=leg, at_s=at_s)]
        line = Line(protocol, *late)
        while line.tick * PERIOD_NS < 1e9 * (0.05 + gap_s * LEGS):
            line.step()
        line.until_set_up()
        assert protocol.set_up_lacks(line.dialogue) == ("",) * LEGS
        if self.SETS_WATCHDOG:
            assert line.nodes._drives.seen.watchdog_ns.tolist() == [50_000_000] * LEGS
        line.restart()

    @pytest.mark.parametrize("seed", [0, 1, *LONG_SEEDS])
    def test_drives_switched_on_in_any_order_become_ready(self, protocol, seed):
        generator = np.random.default_rng(seed)
        self.powers_up(protocol, generator.permutation(LEGS).tolist(), float(generator.uniform(0.0, 0.25)))

    def test_drives_powered_before_the_controller_are_set_up(self, protocol):
        line = Line(protocol)
        line.alone(100)
        line.replace_controller()
        line.until_set_up()
        line.restart()

    def test_a_drive_switched_off_and_on_at_rest_is_set_up_again(self, protocol):
        off, on = DriveSilence(leg=2, at_s=0.6, for_s=0.15), DriveReset(leg=2, at_s=0.75)
        line = Line(protocol, off, on)
        line.until_set_up()
        while line.tick * PERIOD_NS < 800_000_000:
            line.step()
        line.until_set_up()
        line.restart()
        if self.SETS_WATCHDOG:
            assert line.nodes._drives.seen.watchdog_ns.tolist() == [50_000_000] * LEGS

    def test_a_restart_in_motion_leaves_the_other_drives_running(self, protocol):
        line = Line(protocol, DriveReset(leg=2, at_s=0.9))
        line.running()
        while line.tick * PERIOD_NS < 890_000_000:
            line.step(RUN, set_up=False)
        assert line.states() == [DriveState.RUN] * LEGS
        for _ in range(30):
            line.step(RUN, set_up=False)
            assert [line.states()[leg] for leg in (0, 1, 3, 4, 5)] == [DriveState.RUN] * 5
        obeys = self.RESTART == "obeys"
        assert line.states()[2] == (DriveState.BOOT if self.RESTART == "boot" else DriveState.RUN)
        assert line.nodes.snapshot().brake.tolist() == [0, 0, not obeys, 0, 0, 0]
        assert bool(line.nodes.snapshot().command[2]) == obeys
        line.recover()
        line.restart()

    # faults, silence

    def test_a_fault_is_reported_with_its_leg_and_its_meaning(self, protocol):
        line = Line(protocol)
        line.running()
        now_ns, n = line.nodes.now_ns, line.nodes._drives.seen
        assert fail(n, LEG, int(DriveFault.OVERFORCE), now_ns)
        holds = Configure(LEG, 1e-9 * int(n.watchdog_ns[LEG]), Reaction(int(n.reaction[LEG])))
        status = Status(LEG, DriveState.FAULT, DriveFault.OVERFORCE, holds, False)
        line.to_controller += [Received(now_ns, frame) for frame in announce(line.nodes._end, status)]
        for _ in range(12):
            line.step(RUN, set_up=False)
        states, codes = line.states(), line.measurement["drive_fault"].tolist()
        if not self.TELLS_FAULTS:
            assert states == [DriveState.RUN] * LEGS
            return
        assert [state == DriveState.FAULT for state in states] == [leg == LEG for leg in range(LEGS)]
        assert [bool(code) for code in codes] == [leg == LEG for leg in range(LEGS)]
        known = codes[LEG] in tuple(DriveFault)
        assert known or protocol.fault_text(codes[LEG])
        if self.CLEARS:
            line.recover()
        else:
            for _ in range(3 + protocol.traits.reset_ticks):
                line.step(RESET)
            assert line.states()[LEG] == DriveState.FAULT

    def test_watchdogs_remove_the_force_and_a_new_controller_takes_over(self, protocol):
        line = Line(protocol)
        line.running()
        line.alone(50)
        snapshot = line.nodes.snapshot()
        found = DriveState.FAULT if self.WATCHED else DriveState.RUN
        assert snapshot.state.tolist() == [found] * LEGS
        line.replace_controller()
        while not all(protocol.legs_set_up(line.dialogue)):
            line.step()
        for _ in range(8):
            line.step()
        if self.WATCHED and self.LATCHES:
            assert line.states() == [DriveState.FAULT] * LEGS
            assert line.measurement["drive_fault"].all(), "each has a fault code"
        line.recover()
        line.restart()

    def test_drives_left_enabled_are_switched_off_by_a_new_controller(self, protocol):
        line = Line(protocol)
        line.running()
        line.replace_controller()
        for _ in range(3):
            line.step()
        assert line.nodes.snapshot().brake.all()
        assert not line.nodes.snapshot().command.any()
        line.recover()
        line.restart()

    def test_missing_heartbeats_block_set_up_only_if_it_needs_them(self, protocol):
        if self.BEATS is None:
            assert not self.beat_ids(protocol)
            return
        line, beats = Line(protocol), self.beat_ids(protocol)
        heard: set[int] = set()

        def drop(frames: list[Received]) -> list[Received]:
            heard.update(each.frame.id for each in frames)
            return [each for each in frames if each.frame.id not in beats]

        line.to_hear = drop
        for _ in range(150):
            line.step()
        assert heard >= beats, "they are sent"
        needed = self.BEATS != "nothing"
        assert protocol.legs_set_up(line.dialogue) == (not needed,) * LEGS
        assert all(protocol.set_up_lacks(line.dialogue)) == needed

    def test_lost_heartbeats_are_noticed_if_only_they_carry_the_state(self, protocol):
        if self.BEATS is None:
            return
        line, beats = Line(protocol), self.beat_ids(protocol)
        line.running()
        line.to_hear = lambda frames: [
            each for each in frames if each.frame.id not in beats or protocol.sender(each.frame) == 3
        ]
        for _ in range(100):
            line.step(RUN, set_up=False)
        lost = DriveState.BOOT if self.BEATS == "state" else DriveState.RUN
        assert line.states() == [DriveState.RUN if leg == 3 else lost for leg in range(LEGS)]
        line.to_hear = list
        for _ in range(12):
            line.step(RUN, set_up=False)
        assert line.nodes.snapshot().state.tolist() == [DriveState.RUN] * LEGS

    @pytest.mark.parametrize("seed", [1, *LONG_SEEDS])
    def test_all_drives_run_again_after_random_faults(self, protocol, seed):
        generator = np.random.default_rng(seed)
        resets = [
            DriveReset(leg=int(generator.integers(LEGS)), at_s=float(t)) for t in generator.uniform(0, 1, 4)
        ]
        begins = generator.uniform(0, 1, 3)
        silences = [
            DriveSilence(leg=int(generator.integers(LEGS)), at_s=float(t), for_s=0.12) for t in begins
        ]
        line = Line(protocol, *resets, *silences)
        wild = [OFF, READY, RUN, RESET, Command(DriveMode.RUN, -FORCE)]

        def lossy(frames: Sequence[Frame]) -> list[Frame]:
            return [
                frame._replace(data=frame.data[: int(generator.integers(9))]) if hit > 0.9 else frame
                for frame, hit in zip(frames, generator.random(len(frames)), strict=True)
                if hit > 0.05
            ]

        line.to_obey = lossy
        while line.tick * PERIOD_NS < 1_300_000_000:
            command = wild[int(generator.integers(len(wild)))]
            for _ in range(int(generator.integers(1, 12))):
                first = protocol.traits.emergency_stop if generator.random() < 0.02 else ()
                line.step(command, first=first)
            if generator.random() < 0.03:
                line.replace_controller()
        line.to_obey = list
        for _ in range(30):
            line.step()
        line.recover()
        line.restart()
