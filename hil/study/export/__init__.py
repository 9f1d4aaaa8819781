"""`hil export`: a log's frames and columns as files that other tools read."""
