"""`hil watch`: a live page about a run from the mirror of its recorder, served by a separate process."""
