"""Many runs, and what one sees of them: campaigns, faults, comparisons, reports, viewers."""
