"""`hil new`: writes a configuration that passes `hil check`, from the user's answers to questions."""
