"""`hil replay --what-if`: the response of another controller to recorded measurements."""
