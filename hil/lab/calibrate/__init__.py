"""`hil calibrate`: fits joint centres and leg length offsets of a platform to measured poses."""
