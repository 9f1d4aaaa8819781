"""A law of stiffness, damping and weight compensation: tau = J^-T (K e + D (twist_d - twist) + G)."""

import numpy as np

from hil.config.model import ModelSettings
from hil.config.values import Positive
from hil.control.law import LawContext, LawSettings


class SoftLaw:
    def __init__(self, K, D, model):
        self.K, self.D, self.model = K, D, model

    def reset(self):
        """Do nothing: this law accumulates nothing."""

    def effort(self, tick):
        e = np.linalg.solve(tick["J"], tick["q_d"] - tick["q"])
        strays = tick["twist_d"] - tick["twist"]
        F = self.K * e + self.D * strays + self.model.gravity(tick["p"], tick["R"])
        tick["tau_law"] = np.linalg.solve(tick["J"].T, F)


class SoftSettings(LawSettings):
    stiffness_N_m: Positive
    damping_N_s_m: Positive

    def build(self, context: LawContext) -> SoftLaw:
        model = context.model(ModelSettings())
        return SoftLaw(self.stiffness_N_m, self.damping_N_s_m, model)
