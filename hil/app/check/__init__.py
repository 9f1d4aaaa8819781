"""`hil check`: what a configuration means before anything moves."""
