"""Sensors next to the drives: one table-driven codec, and one file for each family of devices."""
