from hil.contracts.law import LawContract
from soft.law import SoftSettings


class TestSoft(LawContract):
    settings = SoftSettings(law="soft", stiffness_N_m=2e6, damping_N_s_m=8e4)
