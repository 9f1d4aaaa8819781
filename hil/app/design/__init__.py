"""`hil design`: computes an H-infinity or mu controller from a design file."""
