"""The control loop: one tick (cycle, modes, motion), the daemon that runs it, and replay."""
