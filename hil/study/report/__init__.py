"""`hil report`: writes one HTML page about a run, from its log alone.

Texts of a log are untrusted input. They become HTML only in `page`, which escapes all of them.
"""
