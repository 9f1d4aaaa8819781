"""CiA 402 drives keep the contract of a drive protocol."""

from __future__ import annotations

import pytest

from hil.contracts.protocol import ProtocolContract
from hil.contracts.trouble import TroubleContract
from tests.drivers.cia402_drives import PERMILLE_N, STEP_m, drives


class TestCia402WithVelocity(TroubleContract):
    RESOLUTION = (STEP_m, STEP_m, PERMILLE_N, PERMILLE_N)
    LENGTHS = (-326.0, 327.0)
    """2^31 counts of 20 mm / 2^17 about 0.75 m."""
    SPEED = 327.0
    MOST_N = 10_000.0
    """0x6072 in the drive."""
    BEATS = "nothing"

    def beat_ids(self, protocol):
        return {0x701, 0x702, 0x703, 0x704, 0x705, 0x706}

    @pytest.fixture
    def family(self):
        return drives()


class TestCia402WithoutVelocity(ProtocolContract):
    RESOLUTION = (STEP_m, 1.5, PERMILLE_N, PERMILLE_N)
    READS_RATES = False
    """The legs of the contract stand still and say that they move: only a PDO tells that."""

    @pytest.fixture
    def family(self):
        return drives((126, 20, 30, 40, 50, 1), velocity=False)
