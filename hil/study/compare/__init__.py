"""`hil compare`: all laws on one platform and path."""
