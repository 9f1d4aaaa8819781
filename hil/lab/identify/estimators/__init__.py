"""Identification from a log: the delay from command to force, linearised axes, masses and friction."""
