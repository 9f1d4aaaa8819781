"""`hil replay --what-if`: computes the outputs of another controller for recorded measurements."""
