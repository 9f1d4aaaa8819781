"""`hil faults`: a matrix of kinds of faults and moments of a run, and its verdicts."""
