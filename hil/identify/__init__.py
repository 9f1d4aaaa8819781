"""Identification from a log: the delay from command to force, and the linearised axes."""
