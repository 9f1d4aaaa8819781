"""`hil stability`: what can be proven of the configured law."""
