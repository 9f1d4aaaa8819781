"""`hil new`: from answers to a configuration that passes `hil check`."""
