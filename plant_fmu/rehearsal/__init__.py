"""A rehearsal bench: six emulated drives, wired as a Wiring states, with legs on trestles or a platform."""
