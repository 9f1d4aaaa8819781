"""`hil compare`: measures all control laws on one platform and path in simulation."""
