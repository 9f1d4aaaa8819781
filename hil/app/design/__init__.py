"""`hil design`: a controller file from a design file."""
