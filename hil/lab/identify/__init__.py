"""`hil identify`: delay and linearised axes from runs and logs."""
