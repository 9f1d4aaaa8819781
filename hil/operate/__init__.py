"""The operator channel: its commands, the socket in the control loop, and the client for operators."""
