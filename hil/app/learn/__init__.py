"""`hil learn`: the feed-forward of the next run, from the logs of those before."""
