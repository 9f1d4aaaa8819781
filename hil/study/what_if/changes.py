"""`--set KEY=VALUE`: changes to a configuration, in the words of the command line."""

import re
from collections.abc import Sequence
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.yaml_positions import parse
from hil.study.campaign.keys import put

_PLACE = re.compile(r"^.*?:\d+:\d+: ")


def read_changes(words: Sequence[str]) -> dict[str, Any]:
    """Return changes as `hil.app.configuration.changes` takes them, of words as `controller.wn_rad_s=25`.

    A value is YAML; an empty one takes a key or a section away, and its default holds.

    Raises ConfigurationError: words of another form, or a key in one that is set to a value.
    """
    found: dict[str, Any] = {}
    for each in words:
        key, equals, text = each.partition("=")
        document = parse(f"value: {text}")
        if not equals or document.problems or document.value is None or set(document.value) != {"value"}:
            raise ConfigurationError(
                f"--set {each}: allowed: section.key=value with a YAML value, as controller.wn_rad_s=25; a "
                "list or a section is given as a whole, as 'monitor={action: warn}'"
            )
        try:
            put(found, key, document.value["value"])
        except ConfigurationError as error:
            raise ConfigurationError(f"--set {error}") from None
    return found


def changed(c: Configuration, words: Sequence[str], *, own: bool) -> Configuration:
    """Return a configuration with changes.

    own : it is the configuration in a log, whose folder nobody looks into.

    Raises ConfigurationError as `read_changes`; and for what the changed configuration has wrong.
    """
    if not words:
        return c
    name = f"{c.source} with --set"
    text = with_changes(c.text, {"name": c.name} | read_changes(words))
    try:
        return loads(text, name, None if own else c.folder)
    except ConfigurationError as error:  # nobody has the text in which it is wrong
        problems = (_PLACE.sub(f"{name}: ", problem) for problem in error.problems)
        raise ConfigurationError(*problems) from None
