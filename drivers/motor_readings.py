"""Readings of drives that consist of several messages, each sent by the drive's timer."""

from typing import Any

from drivers.compiled.compiler import helper


@helper
def joins(m: Any, heard: Any, whole: Any, t_ns: int, motion: int) -> bool:
    """Add a message to its drive's reading; True if that is complete, and then in `heard`.

    m: record of MOTORS; heard, whole: HEARD records of the message and of its reading; motion: bit MOTION.
    """
    leg, mine = heard.leg, 1 << heard.part
    if m.got[leg] & mine or t_ns - m.began_ns[leg] > m.gap_ns:
        m.got[leg] = 0
    if m.got[leg] == 0:
        m.began_ns[leg], whole.has, whole.power, whole.fault = t_ns, motion, 0, 0
        whole.turns = whole.speed = whole.torque = 0.0
    m.got[leg] |= mine
    whole.has = (whole.has | heard.has) & ~motion | whole.has & heard.has & motion
    heard.has = whole.has
    heard.power = whole.power = max(whole.power, heard.power)
    heard.fault = whole.fault = whole.fault + heard.fault
    heard.turns = whole.turns = whole.turns + heard.turns
    heard.speed = whole.speed = whole.speed + heard.speed
    heard.torque = whole.torque = whole.torque + heard.torque
    complete = m.got[leg] == m.parts
    m.got[leg] = 0 if complete else m.got[leg]
    return bool(complete)
