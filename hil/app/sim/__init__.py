"""`hil sim`: both ends of the bus in lockstep."""
