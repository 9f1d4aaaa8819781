"""`hil design`: a design file in, a controller file out."""
