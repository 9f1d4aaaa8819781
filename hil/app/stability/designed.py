"""Assessment of a designed linear controller around inverse dynamics: eigenvalues, margins, peak gain."""

import numpy as np

from hil.app.configuration.controller_file import controller_of
from hil.app.stability.subject import Subject
from hil.app.stability.wording import beside, describe, unstable
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.control.state_space import StateSpaceSettings
from hil.stability.assessment import Assessment, unless
from hil.stability.disturbance import along, summary
from hil.stability.sampled import analyse
from hil.stability.sampled_loop import sampled_controller
from hil.stability.ultimate import EXACT


def configured(subject: Subject, law: StateSpaceSettings) -> Assessment:
    """Judge the controller that the law names. Raises ConfigurationError where its file is no good."""
    controller = controller_of(law, subject.c.folder)
    assert controller is not None
    return designed(subject, controller, law.model)


def designed(subject: Subject, controller: LinearController, model: ModelSettings) -> Assessment:
    """Judge u of a linear controller by the eigenvalues of the sampled loop, at the stated model errors."""
    conditions, worst, d, gamma = [], None, np.zeros(6), 1.0
    for linearised in subject.linearised(model, controller.axes):
        found = summary(along(linearised, subject.path))
        loop = analyse(subject.axis._replace(gain=found.gamma), sampled_controller(controller))
        off = float(found.spread.max())
        if off > EXACT:
            conditions.append(f"the believed inertia, {100 * off:.2g} % off beyond its scale, changes little")
        if worst is None or not loop.peak_gain * found.d.max() < worst.peak_gain * d.max():
            worst, d, gamma = loop, found.d, found.gamma
    assert worst is not None
    lines, figures = describe(worst)
    figures |= {"axes": controller.axes, "gamma": gamma, "order": len(controller.A)}
    if not worst.stable:
        return Assessment("unstable", unstable(subject, worst), [], lines, figures)
    claim = f"errors die out as exp(-{worst.decay_rate:.3g} t)"
    if d.max() > 1e-6:
        error = worst.peak_gain * d
        figures |= {"disturbance": d.tolist(), "ultimate_bound": error.tolist()}
        conditions.append("what disturbs within the bound is what disturbs on the reference")
        size = f"{1e3 * error.max():.3g} mm of leg length"
        if controller.axes == "pose":
            size = f"{1e3 * error[:3].max():.3g} mm and {np.degrees(error[3:].max()):.3g} deg"
        claim += f" and stay below {size} along the reference{beside(subject)}"
        lines.append(f"disturbance    {d.max():.3g} m/s^2 times the peak gain of the sampled loop")
    if subject.c.plant is None:
        conditions.append("the robot is as section platform says, its drives have neither friction nor lag")
    return Assessment(unless(conditions), claim, conditions, lines, figures)
