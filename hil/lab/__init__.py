"""Tools that commission a real machine: bring-up, identification, calibration and learning."""
