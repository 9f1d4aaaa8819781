"""Studies of many runs: campaigns, fault cases, comparisons, reports, viewers."""
