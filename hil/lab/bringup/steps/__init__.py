"""The steps of a bring-up, one check per file."""
