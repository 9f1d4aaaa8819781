"""Rehearsal of a bring-up: six emulated drives, wired as a Wiring states, with legs on stands or mounted."""
