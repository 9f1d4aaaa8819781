"""`make mutants`: a seeded sample of plausible mistakes, one at a time, and the test that detects each."""
