"""The configuration of robot, bus, controller and plant: one YAML file, one section per package."""
