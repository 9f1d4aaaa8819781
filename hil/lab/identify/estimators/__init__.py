"""Estimators for data from logs: the delay from command to force, linearised axes, masses and friction."""
