"""`hil identify`: estimates loop delay, linearised axes, payload and friction from runs and logs."""
