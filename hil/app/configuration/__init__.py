"""The configuration: one YAML file, composed of each package's own sections."""
