"""The Stewart-Gough plant: physics in C (`sources`), and its packaging as an FMU."""
