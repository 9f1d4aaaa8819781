"""Section `watch`: the live page."""

from drivers.section import Section


class WatchSettings(Section):
    """The live page of `hil watch`."""

    operate: bool = False
    """The page may operate the platform, not only show it; each of its commands carries the token."""
