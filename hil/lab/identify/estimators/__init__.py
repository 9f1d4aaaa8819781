"""Estimators for log data: delay from command to force, linearised axes, masses and friction."""
