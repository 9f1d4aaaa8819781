"""Contract of every control law. The test class of a law gives its settings.

::

    class TestMine(LawContract):
        settings = MySettings(law="mine", kp_N_m=1e5)
"""

from typing import ClassVar

import numpy as np
import pytest

from drivers.tick_columns import Record
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.contracts.records import arrived, asked
from hil.control.law import Law, LawContext, LawSettings
from hil.loop.reference import fill_reference
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.geometry import Platform
from hil.trajectory.path import PoseSample


class LawContract:
    """Contract suite of a law: set `settings` or a fixture `law`; fixture `platform` for another robot."""

    settings: ClassVar[LawSettings]

    @pytest.fixture
    def platform(self) -> Platform:
        """Robot of the shipped configuration `virtual`."""
        return build_platform(load("virtual").platform)

    @pytest.fixture
    def home(self) -> PoseSample:
        """Home pose of the robot, at rest."""
        return PoseSample(*pose_arrays(load("virtual").platform.home), np.zeros(6), np.zeros(6))

    @pytest.fixture
    def samples(self, home: PoseSample) -> list[PoseSample]:
        """Poses near home in motion: within 3 cm and 0.1 rad, at up to some m/s, rad/s, m/s^2, rad/s^2."""
        random = np.random.default_rng(5)
        return [
            PoseSample(
                home.p + random.uniform(-0.03, 0.03, 3),
                rotation_from_vector(random.uniform(-0.1, 0.1, 3)) @ home.R,
                *random.normal(0.0, [[0.3], [2.0]], (2, 6)),
            )
            for _ in range(20)
        ]

    @pytest.fixture
    def law(self, platform: Platform, home: PoseSample) -> Law:
        return self.settings.build(LawContext(platform, "none", 1e-3))

    @pytest.fixture
    def ticks(self, platform: Platform, samples: list[PoseSample]) -> list[Record]:
        return [arrived(platform, sample) for sample in samples]

    def test_finite_inputs_give_finite_forces(self, law: Law, ticks: list[Record]) -> None:
        random = np.random.default_rng(7)
        for tick in ticks:
            tick["q"] += random.normal(0, 0.01, 6)
            tick["dq"] += random.normal(0, 0.1, 6)
            assert np.isfinite(asked(law, tick)).all()

    def test_a_reset_law_repeats_its_forces_to_the_bit(self, law: Law, ticks: list[Record]) -> None:
        first = [asked(law, tick).tobytes() for tick in ticks]
        law.reset()
        assert [asked(law, tick).tobytes() for tick in ticks] == first

    def test_extreme_finite_inputs_give_numbers_or_nan(self, law: Law, platform: Platform) -> None:
        """Poses far out of reach, any rotation, extreme speeds and shortfalls: no exception."""
        random = np.random.default_rng(3)
        for size in np.repeat([0.1, 1.0, 30.0, 1e3], 25):
            p, p_d = random.normal(0, size, (2, 3))
            R, R_d = (rotation_from_vector(turn) for turn in random.normal(0, 2.0, (2, 3)))
            twist, twist_d, dtwist_d = random.normal(0, size, (3, 6))
            tick = arrived(platform, PoseSample(p, R, twist, np.zeros(6)))
            tick["q"] += random.normal(0, size, 6)
            tick["wrench"] = random.normal(0, 1e3 * size, 6)
            fill_reference(platform, PoseSample(p_d, R_d, twist_d, dtwist_d), tick)
            assert not np.isinf(asked(law, tick, shortfall=random.normal(0, 1e4 * size, 6))).any()

    def test_a_nan_pose_gives_nan_or_an_exception(self, law: Law, ticks: list[Record]) -> None:
        """A pose of nan gives nan or an exception, and the controller turns either into a fault."""
        try:
            tau = asked(law, ticks[0], q=np.nan, dq=np.nan, p=np.nan, R=np.nan, J=np.nan, twist=np.nan)
        except Exception:  # noqa: BLE001 - whatever a law raises
            return
        assert np.isnan(tau).all()

    def test_a_limited_force_does_not_wind_up_the_law(self, law: Law, ticks: list[Record]) -> None:
        """If only half of the force is applied, the law demands the same force after 2 s and after 20 s."""
        tick = ticks[5]
        tick["q"] -= 2e-3
        limit = 0.5 * np.abs(asked(law, tick))
        last = []
        for calls in (2_000, 20_000):
            law.reset()
            tick["shortfall"] = 0.0
            for _ in range(calls):
                law.effort(tick)
                tau = tick["tau_law"].copy()
                tick["shortfall"] = np.clip(tau, -limit, limit) - tau
            last.append(tau)
        np.testing.assert_allclose(last[1], last[0], rtol=1e-9)
