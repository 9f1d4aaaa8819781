"""CiA 402 drives keep the contract of a drive protocol."""

from __future__ import annotations

import pytest

from tests.drivers.cia402_drives import PERMILLE_N, STEP_m, drives
from tests.drivers.protocol_contract import ProtocolContract


class TestCia402WithVelocity(ProtocolContract):
    RESOLUTION = (STEP_m, STEP_m, PERMILLE_N, PERMILLE_N)

    @pytest.fixture
    def protocol(self):
        return drives()


class TestCia402WithoutVelocity(ProtocolContract):
    RESOLUTION = (STEP_m, 1.5, PERMILLE_N, PERMILLE_N)
    """The legs of the contract stand still and say that they move: only a PDO tells that."""

    @pytest.fixture
    def protocol(self):
        return drives((126, 20, 30, 40, 50, 1), velocity=False)
