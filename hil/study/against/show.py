"""The comparison of two logs as a table."""

from typing import Any

from hil.study import divergences
from hil.study.against.command import SIDES
from hil.study.table import Column


def show(result: dict[str, Any]) -> None:
    """Print a line for each column with a difference; nothing where there is none."""
    allowed = Column("allowed", _allowed)
    divergences.show(result["columns"], SIDES, [allowed], lambda each: "red" if each["diverges"] else "")


def shown(result: dict[str, Any]) -> dict[str, Any]:
    """Return what a terminal shows above the table."""
    found: dict[str, Any] = {"success": result["success"]}
    for key in ("log", "against", "ticks_compared", "columns_compared"):
        found[key.replace("_", " ")] = result[key]
    if result["align"] != "tick":
        found["aligned by"] = "the first motion"
    for key in ("only_in_log", "only_in_other"):
        if result[key]["ticks"]:
            found[f"ticks {key.replace('_', ' ')}"] = (
                f"{result[key]['ticks']}, the first {result[key]['first']}"
            )
    for key in ("columns_only_in_log", "columns_only_in_other", "columns_of_another_type"):
        found[key.replace("_", " ")] = ", ".join(result[key]) or None
    first = next((each["first"] for each in result["columns"] if each["diverges"]), None)
    found["first divergence"] = None if first is None else divergences.sentence(first, SIDES)
    return found | {"diverging columns": len(result["diverging"])}


def _allowed(each: dict[str, Any]) -> str:
    if each["tolerance"] == "not judged":
        return "any"
    if each["relative_tolerance"]:
        return f"{each['relative_tolerance']:g} relative"
    return "exact" if not each["tolerance"] else f"{each['tolerance']:g}"
