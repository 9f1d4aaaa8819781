"""From parts to a machine: bring-up, identification, calibration, learning."""
