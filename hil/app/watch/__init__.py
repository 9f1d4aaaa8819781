"""`hil watch`: serves a live page about a run, from shared memory of its recorder, in its own process."""
