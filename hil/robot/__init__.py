"""The robot: geometry, inertia, kinematics, dynamics, and the way of its leg forces."""
