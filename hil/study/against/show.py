"""The comparison of two logs as a table."""

from typing import Any

from rich.text import Text

from hil.app.output import print_table
from hil.study.table import results

TITLES = (
    *("column", "first tick", "s", "log", "other"),
    *("in ticks", "largest", "at tick", "allowed", "unit"),
)


def show(result: dict[str, Any]) -> None:
    """Print a line for each column with a difference; nothing where there is none."""
    if not result["columns"]:
        return
    table = results(*TITLES, left=("column", "unit"))
    for each in result["columns"]:
        style = "red" if each["diverges"] else ""
        table.add_row(*(Text(cell, style=style) for cell in _cells(each)))
    print_table(table)


def shown(result: dict[str, Any]) -> dict[str, Any]:
    """Return what a terminal shows above the table."""
    diverging = result["diverging"]
    first = next((each for each in result["columns"] if each["diverges"]), None)
    kept = ("success", "log", "against", "ticks_compared", "columns_compared")
    found = {key.replace("_", " ") if key != "success" else key: result[key] for key in kept}
    if result["align"] != "tick":
        found["aligned by"] = "the first motion"
    for key, text in (
        ("only_in_log", "ticks only in the log"),
        ("only_in_other", "ticks only in the other"),
    ):
        if result[key]["ticks"]:
            found[text] = f"{result[key]['ticks']}, the first {result[key]['first']}"
    for key in ("columns_only_in_log", "columns_only_in_other", "columns_of_another_type"):
        if result[key]:
            found[key.replace("_", " ")] = ", ".join(result[key])
    if first is not None:
        place = first["first"]
        found["first divergence"] = (
            f"tick {place['tick']} ({place['time_s']:.3f} s): {place['element']}: {place['log']}, other "
            f"{place['other']} {place['unit']}".rstrip()
        )
    found["diverging columns"] = len(diverging)
    return found


def _cells(each: dict[str, Any]) -> list[str]:
    first, at = each["first"], each["at"]
    largest = "-" if each["largest"] is None else f"{each['largest']:.4g}"
    where = ["-", "-", "-", "-"]
    if first is not None:
        values = (_short(first[key]) for key in ("log", "other"))
        where = [str(first["tick"]), f"{first['time_s']:.3f}", *values]
    name = each["column"] if first is None else first["element"]
    return [name, *where, str(each["ticks"]), largest, str(at["tick"]), _allowed(each), each["unit"]]


def _short(value: str) -> str:
    try:
        return f"{float(value):.6g}" if "." in value or "e" in value else value
    except ValueError:
        return value


def _allowed(each: dict[str, Any]) -> str:
    if each["tolerance"] == "not judged":
        return "any"
    if each["relative_tolerance"]:
        return f"{each['relative_tolerance']:g} relative"
    return "exact" if not each["tolerance"] else f"{each['tolerance']:g}"
