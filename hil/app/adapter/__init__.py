"""Qualification of a CAN adapter: measured once, budgeted by `hil check`, compared by `hil run`."""
