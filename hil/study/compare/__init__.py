"""`hil compare`: measure all control laws on one platform and path."""
