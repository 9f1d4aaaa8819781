"""`hil watch`: a live page about a run, served by a process of its own.

It reads the mirror of the recorder (`hil.record.mirror`) and, where the configuration allows it, speaks to
the operator's socket as any operator does. Nothing of the run waits for it.
"""
