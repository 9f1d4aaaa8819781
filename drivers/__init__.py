"""Frames <-> SI: protocols, codecs and the bus. No control, no clock, no files."""
