"""The robot: geometry, inertia, kinematics, dynamics, and the delay and lag of its leg forces."""
