"""`make mutants`: a seeded sample of plausible mistakes, one at a time, and which claim notices each."""
