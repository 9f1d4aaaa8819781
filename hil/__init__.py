"""The controller: geometry, dynamics, control laws, safety, the cycle, recording and replay."""
