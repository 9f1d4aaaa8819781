"""`hil check`: prints figures and warnings about a configuration before anything moves."""
