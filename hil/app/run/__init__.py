"""`hil run`: the real-time controller, and the plant that it may start."""
