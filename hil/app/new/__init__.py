"""`hil new`: a configuration that passes `hil check`, from answers."""
