"""`hil report`: one page about a run, from its log alone.

Texts of a log are input from strangers: they become HTML in `page` alone, which escapes all of them.
"""
