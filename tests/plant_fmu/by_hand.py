"""Drives that are moved by hand: a part of the compiled pass, called in Python."""

from __future__ import annotations

from plant_fmu.drives import drive_rules
from plant_fmu.drives.drive import Drives


def enter(drives: Drives, leg: int, state: int, reason: int) -> None:
    """Change the state of one drive."""
    drive_rules.enter(drives.seen, leg, state, reason)
