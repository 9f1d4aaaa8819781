"""`hil check`: figures and warnings of a configuration before anything moves."""
