"""Configuration sections of the controller, one file each."""
