"""`hil stability`: proves stability of the configured control law, or reports why there is no proof."""
