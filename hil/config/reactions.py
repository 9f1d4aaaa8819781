"""Section `reactions`: what is done about each fault."""

from typing import Literal

from drivers.section import Section
from drivers.signals import Fault

Stop = Literal["ss1", "sbc", "sto"]
"""ss1: a stop under control, along the path, within `engage.stop_s`; then as sbc. sbc: the brakes at once,
and the force stays on until they are proven shut. sto: no force and the brakes, at once, unproven."""
Brake = Literal["sbc", "sto"]


class ReactionSettings(Section):
    """What is done about each fault that strikes while the brakes are open, by what is still known.

    The words are those of IEC 61800-5-2: safe stop 1, safe brake control, safe torque off. After the first
    two a platform whose brakes are not proven shut keeps its force where there is any; `sto` takes it off at
    once, in every mode. Of several faults the strongest reaction counts. An emergency stop, a bus that is
    down, another controller, and drives that none of them is heard of any more, are always `sto`: there is
    nobody who could obey.
    """

    stale: Brake = "sbc"
    """A leg is not heard."""
    drive: Brake = "sbc"
    """One drive has failed; the others hold."""
    stroke: Stop = "sbc"
    speed: Stop = "sbc"
    following: Stop = "sbc"
    """The legs do not follow the reference: a stop along it cannot be relied on."""
    kinematics: Brake = "sbc"
    assembly: Brake = "sbc"
    condition: Stop = "sbc"
    not_finite: Brake = "sbc"
    law: Brake = "sbc"
    encoder: Brake = "sbc"
    """An encoder is not believed."""
    uncertain: Brake = "sbc"
    certificate: Stop = "ss1"
    duplicate_node: Brake = "sbc"
    refused_frames: Stop = "ss1"
    set_up: Stop = "ss1"
    silence: Literal["brake", "damp", "hold", "zero"] = "brake"
    """What a drive does by itself when it hears no command in motion. `brake`: its brake, and its last force
    until that has closed; `damp`, `hold`: against its speed, or in its place, then its brake, see
    `drives.brake_after_ms`; `zero`: no force and no brake. An emergency stop always brakes."""

    def led_to(self, reaction: str) -> Fault:
        """Return the faults that lead to a reaction."""
        faults = Fault.NONE
        for name in Fault.__members__:
            if getattr(self, name.lower(), "") == reaction:
                faults |= Fault[name]
        return faults
