"""The comparison as tables on the terminal."""

from collections.abc import Callable
from typing import Any

from rich.table import Table
from rich.text import Text

from hil.app.output import Terminal, number, print_table
from hil.app.terminal import visible
from hil.study.table import results

Columns = tuple[tuple[str, str, str], ...]
"""Title, key of a law's figures, format; empty: as in summaries, whatever the robot's size."""
PATH: Columns = (
    ("leg mm\npeak", "peak_leg_error_mm", ".3g"),
    ("\nRMS", "rms_leg_error_mm", ".3g"),
    ("position\npeak mm", "peak_position_error_mm", ".3g"),
    ("rotation\npeak deg", "peak_rotation_error_deg", ".2g"),
    ("force\npeak N", "peak_force_N", ""),
    ("force\nvar. N", "force_variation_N", ""),
)
STEP: Columns = (
    ("at rest\nleg mm", "steady_leg_error_mm", ".2g"),
    ("rise\nms", "rise_ms", ".0f"),
    ("over-\nshoot %", "overshoot_percent", ".1f"),
    ("-3 dB\nHz", "bandwidth_Hz", ".3g"),
)
LOAD: Columns = (
    ("leg mm\npeak", "disturbed_peak_leg_error_mm", ".3g"),
    ("\nat rest", "disturbed_steady_leg_error_mm", ".3g"),
)
ABSENT = "-"


def show(summary: dict[str, Any], width: int | None = None) -> None:
    """Print the laws, the losses path by path, and the claims."""
    out = Terminal(width=width)
    step = summary["step"]
    parts = {
        f"Along {summary['duration_s']:g} s of the reference": _laws(summary, PATH, result),
        f"At home: at rest, then a step of {step['axis']} by {step['size']:g}": _laws(summary, STEP, unrest),
        "The disturbance, held at home": _laws(summary, LOAD) if summary["disturbance"] else None,
        "What the path to the legs costs: peak leg error in mm": _paths(summary)
        if summary["paths"]
        else None,
        "What the control chapter says, and whether it holds here": _claims(summary),
    }
    for title, table in parts.items():
        if table is not None and table.row_count:
            out.print(Text(title, style="bold"))
            print_table(table, width)
            out.print()


def shown(summary: dict[str, Any]) -> dict[str, Any]:
    """Return what the tables do not say, for the lines below them."""
    shares = summary["force_shares"]
    terms = {"H": "H", "J_dot": "(dJ/dt) twist", "G": "gravity"}
    scale = summary["inertia_scale"]
    stopped = summary["limits"] != "lifted" and any(row["fault"] for row in summary["laws"].values())
    return {
        "success": summary["success"],
        "configuration": summary["configuration"],
        "limits": summary["limits"] + ("; --lift-limits shows what is beyond" if stopped else ""),
        "masses believed": None if scale == 1.0 else f"{100 * scale:g} % of what each law would",
        "share of the force": ", ".join(
            f"{terms[k]} up to {100 * s['share']:.3g} % ({s['force_N']:.4g} N)" for k, s in shares.items()
        )
        or None,
        "picture": summary["picture"],
        "wall": f"{summary['wall_s']:.1f} s",
    }


def _laws(
    summary: dict[str, Any], columns: Columns, remark: Callable[[dict[str, Any]], str] | None = None
) -> Table:
    table = results("law", *(title for title, *_ in columns), left=("law",))
    remarks = {name: remark(row) if remark else "" for name, row in summary["laws"].items()}
    if any(remarks.values()):
        table.add_column("", style="red")
    for name, row in summary["laws"].items():
        cells = (_cell(row, key, form) for _, key, form in columns)
        table.add_row(visible(name), *cells, *([remarks[name]] if any(remarks.values()) else []))
    return table


def unrest(row: dict[str, Any]) -> str:
    """Say that the answer to the step had not come to rest, nothing where it had."""
    return "not at rest in the end" if row.get("settled") is False else ""


def result(row: dict[str, Any]) -> str:
    """Say what went wrong, nothing where all went well: fault and time, limits that acted."""
    if row["fault"]:
        at = "" if row["fault_s"] is None else f" at {row['fault_s']:.3f} s"
        return f"{row['fault']}{at}"
    acted = [f"{k.lower()} {n}" for k, n in row.get("limited_ticks", {}).items() if n]
    return f"limited ticks: {', '.join(acted)}" if acted else ""


def _paths(summary: dict[str, Any]) -> Table:
    names = list(dict.fromkeys(path for found in summary["paths"].values() for path in found))
    titles = (name if name in (names[0], names[-1]) else f"+ {name}" for name in names)
    table = results("law", *titles, left=("law",))
    for law, found in summary["paths"].items():
        table.add_row(visible(law), *(_path_cell(found.get(name)) for name in names))
    return table


def _claims(summary: dict[str, Any]) -> Table:
    titles = ("section", "claim", "holds", "measured")
    table = results(*titles, left=titles)
    table.columns[1].max_width = 34
    for claim in summary["claims"]:
        holds = Text("yes", style="green") if claim["holds"] else Text("no", style="red")
        table.add_row(claim["section"], claim["claim"], holds, claim["figures"])
    return table


def _path_cell(row: dict[str, Any] | None) -> str | Text:
    if row is None:
        return ABSENT
    return Text(row["fault"], style="red") if row["fault"] else _cell(row, "peak_leg_error_mm", ".4f")


def _cell(row: dict[str, Any], key: str, form: str) -> str:
    value = row.get(key)
    if value is None or value != value:  # noqa: PLR0124 - nan
        return ABSENT
    return format(value, form) if form else number(value)
