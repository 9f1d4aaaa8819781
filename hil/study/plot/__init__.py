"""`hil plot`: columns of logs over time, as a picture."""
