"""`hil run`: the real-time daemon, and the plant that it starts."""
