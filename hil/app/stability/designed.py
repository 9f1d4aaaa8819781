"""Assessment of a designed linear controller around inverse dynamics: eigenvalues, margins, peak gain."""

from typing import Any

from hil.app.configuration.controller_file import controller_of
from hil.app.stability.judged import Inertia
from hil.app.stability.linearising import assumed
from hil.app.stability.subject import SURVEYED, Subject
from hil.app.stability.wording import bound_lines, describe, unstable, worst
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.control.state_space import StateSpaceSettings
from hil.design.stability.assessment import Assessment, unless
from hil.design.stability.sampled import Sampled, analyse
from hil.design.stability.sampled_loop import sampled_controller


def configured(subject: Subject, law: StateSpaceSettings) -> Assessment:
    """Judge the controller that the law names. Raises ConfigurationError where its file is no good."""
    controller = controller_of(law, subject.c.folder)
    assert controller is not None
    return designed(subject, controller, law.model, assumed(subject, law))


def designed(
    subject: Subject, controller: LinearController, model: ModelSettings, conditions: list[str]
) -> Assessment:
    """Judge u of a linear controller by the eigenvalues of the sampled loop, at the stated model errors.

    conditions: what is assumed of the law that runs it.
    """
    sampled = sampled_controller(controller)

    def loops(gain: float) -> list[Sampled]:
        return [analyse(subject.axis._replace(gain=gain), sampled)] * 6

    judged = subject.judged(model, controller.axes, loops)
    loop, bound = judged.slowest, judged.bound
    lines, figures = describe(judged.every)
    figures |= {"axes": controller.axes, "order": len(controller.A)}
    if not loop.stable:
        return Assessment("unstable", unstable(subject, loop), [], lines, figures)
    if isinstance(bound, str):
        return Assessment("not proven", bound, conditions, lines, figures)
    more, numbers = bound_lines(judged, controller.axes)
    lines, figures = more + lines + _coupled(controller, judged.inertia, figures), {**figures, **numbers}
    if subject.undisturbed(bound):
        claim = f"at the reference's pose small errors die out, the slowest as exp(-{loop.decay_rate:.3g} t)"
        return Assessment(unless(conditions), claim, conditions, lines, figures)
    claim = f"errors stay below {worst(bound, controller.axes)} along the reference"
    return Assessment("conditional", claim, [*conditions, SURVEYED], lines, figures)


def inertia_range(controller: LinearController) -> tuple[float, float] | None:
    """Return the eigenvalues of Gamma that a controller was designed for; None where nobody said."""
    if "uncertainty" not in controller.design:
        return None
    gain, share = controller.design["axis"]["gain"], controller.design["uncertainty"]["inertia"]
    return gain / (1.0 + share), gain / (1.0 - share)


def _coupled(controller: LinearController, inertia: Inertia, figures: dict[str, Any]) -> list[str]:
    """Say whether the axes that a wrong inertia couples are those that the controller was designed for."""
    designed_for = inertia_range(controller)
    if designed_for is None:
        return []
    (low, high), (least, largest) = designed_for, inertia.eigenvalues
    covered = low <= least and largest <= high
    figures["coupled_axes_covered"] = covered
    verdict = "all within" if covered else "not all within"
    line = f"coupled axes   Gamma's eigenvalues {least:.3g} to {largest:.3g} are {verdict} "
    return [f"{line}{low:.3g} to {high:.3g}, which the controller was designed for"]
