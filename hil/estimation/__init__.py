"""Pose of the platform, the external wrench on it, and its predicted state when the force acts."""
