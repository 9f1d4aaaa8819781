"""The Stewart-Gough plant: physics in C (`sources`) and what wraps it into an FMU."""
