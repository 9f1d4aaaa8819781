"""The control loop: one tick (cycle, modes, motion), the real-time daemon that runs it, and replay."""
