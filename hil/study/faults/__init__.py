"""`hil faults`: the matrix of faults and moments, and its verdicts."""
