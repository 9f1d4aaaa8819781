"""`hil run`: the daemon in real time, and the plant that it starts."""
