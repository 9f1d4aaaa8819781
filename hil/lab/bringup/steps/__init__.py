"""The steps of a bring-up, a check a file."""
