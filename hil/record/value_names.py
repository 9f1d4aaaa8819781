"""What the number in a column is called."""

from enum import IntFlag

from drivers.tick_columns import Column


def name_of(column: Column, number: int) -> str:
    """Return the name of a number of a column that has names.

    Flags are joined by `|`, with `NONE` where none is set; what has no name stands as a number.
    """
    if not issubclass(column.type, IntFlag):
        return next((name for name, value in column.names.items() if value == number), str(number))
    found = [name for name, bit in column.names.items() if bit and number & bit == bit]
    rest = number & ~sum(column.names.values())
    return "|".join(found + ([str(rest)] if rest else [])) or "NONE"
