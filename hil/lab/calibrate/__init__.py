"""`hil calibrate`: the geometry of a platform from measured poses."""
