"""`hil campaign`: simulates many runs of one configuration with swept keys, and reports the failure rate."""
