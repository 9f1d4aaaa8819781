"""`hil replay --what-if`: what another controller would have answered to recorded measurements."""
