"""One tick and what drives it: cycle, modes, motion, daemon, replay."""
