import numpy as np
import pytest

from cheetah.codec import CheetahProtocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from hil.contracts.trouble import TroubleContract

LEAD_m = 0.1
TURN_m, N_per_Nm = LEAD_m / (2 * np.pi), 2 * np.pi / LEAD_m
# Twice a step, because the codecs truncate.
STEP_m, STEP_m_s, STEP_N = 382.0 / 65535 * TURN_m, 1600.0 / 4095 * TURN_m, 576.0 / 4095 * N_per_Nm


class TestCheetah(TroubleContract):
    RESOLUTION = (STEP_m, STEP_m_s, STEP_N, STEP_N)
    LENGTHS, SPEED = (0.24, 3.26), 6.36
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = TELLS_FAULTS = False
    RESTART = "nothing"

    @pytest.fixture
    def family(self):
        drives = DriveSettings(
            protocol="cheetah",
            node_ids=[1, 2, 3, 4, 5, 15],
            transmission=TransmissionSettings(lead_m=LEAD_m, offset_m=1.75, sign=[1, -1, 1, -1, 1, -1]),
            options={"position_rad": 95.5, "velocity_rad_s": 400, "torque_N_m": 144},
            force_limit_N=9000,
        )
        return CheetahProtocol(BusSettings(layout="classic"), drives)
