"""A rehearsal bench: six emulated drives, wired as a Wiring says, before legs on trestles or a platform."""
