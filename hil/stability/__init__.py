"""What can be proven of a loop: error dynamics, ultimate bounds, energy, reaching, the sampled loop.

Rule of the room: pure mathematics of values, offline; no file, no bus, no clock. This file imports nothing:
each question is a module of its own, and some are heavy.
"""
