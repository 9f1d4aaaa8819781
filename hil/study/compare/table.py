"""Tables of `hil compare` on the terminal."""

from collections.abc import Callable, Sequence
from typing import Any

from rich.text import Text

from hil.study.table import Column, Terminal, figure, figure_column, print_rows

Row = dict[str, Any]


LAW = Column("law", lambda row: row[0], left=True)
PATH = (
    LAW,
    figure_column("leg mm\npeak", "peak_leg_error_mm", ".3g"),
    figure_column("\nRMS", "rms_leg_error_mm", ".3g"),
    figure_column("position\npeak mm", "peak_position_error_mm", ".3g"),
    figure_column("rotation\npeak deg", "peak_rotation_error_deg", ".2g"),
    figure_column("force\npeak N", "peak_force_N"),
    figure_column("force\nvar. N", "force_variation_N"),
    Column("", lambda row: Text(result(row[1]), "red"), left=True),
)
STEP = (
    LAW,
    figure_column("at rest\nleg mm", "steady_leg_error_mm", ".2g"),
    figure_column("rise\nms", "rise_ms", ".0f"),
    figure_column("over-\nshoot %", "overshoot_percent", ".1f"),
    figure_column("-3 dB\nHz", "bandwidth_Hz", ".3g"),
    Column("", lambda row: Text(unrest(row[1]), "red"), left=True),
)
LOOP = (
    LAW,
    figure_column("crossover\nrad/s", "crossover_rad_s", ".0f"),
    figure_column("delay\nmargin ms", "delay_margin_ms", ".3g"),
    Column("gains", lambda row: _gains(row[1]["gains"]), left=True),
    Column("", lambda row: Text(row[1]["remark"] or "", "red"), left=True),
)
LOAD = (
    LAW,
    figure_column("leg mm\npeak", "disturbed_peak_leg_error_mm", ".3g"),
    figure_column("\nat rest", "disturbed_steady_leg_error_mm", ".3g"),
)
CLAIMS = (
    Column("section", lambda claim: claim["section"], left=True),
    Column("claim", lambda claim: claim["claim"], left=True, width=34),
    Column("holds", lambda claim: Text("yes", "green") if claim["holds"] else Text("no", "red"), left=True),
    Column("measured", lambda claim: claim["figures"], left=True),
)


def show(summary: Row) -> None:
    """Print the tables of a comparison: laws, errors by signal path, and the chapter's statements."""
    step, laws = summary["step"], list(summary["laws"].items())
    target = summary["equal_crossover_rad_s"]
    scaled = "" if target is None else f", gains scaled to a crossover of {target:.4g} rad/s"
    _part(f"Along {summary['duration_s']:g} s of the reference", PATH, laws)
    _part(f"Loops at home, with observer, delay and lag of the drives{scaled}", LOOP, laws)
    _part(f"At home: at rest, then a step of {step['axis']} by {step['size']:g}", STEP, laws)
    if summary["disturbance"]:
        _part("The disturbance, held at home", LOAD, laws)
    paths = summary["paths"]
    stages = list(dict.fromkeys(stage for found in paths.values() for stage in found))
    columns = [LAW, *(Column(stage_title(name, stages), _at(name)) for name in stages)]
    _part("Losses of the path to the legs: peak leg error in mm", columns, list(paths.items()))
    _part("Claims of the control chapter, and their results here", CLAIMS, summary["claims"])


def _part(title: str, columns: Sequence[Column], rows: Sequence[Any]) -> None:
    if rows:
        out = Terminal()
        out.print(Text(title, style="bold"))
        print_rows(columns, rows)
        out.print()


def shown(summary: Row) -> Row:
    """Lines of the summary printed below the tables of a comparison."""
    terms = {"H": "H", "J_dot": "(dJ/dt) twist", "G": "gravity"}
    shares = [
        f"{terms[k]} up to {100 * s['share']:.3g} % ({s['force_N']:.4g} N)"
        for k, s in summary["force_shares"].items()
    ]
    scale = summary["inertia_scale"]
    stopped = summary["limits"] != "lifted" and any(row["fault"] for row in summary["laws"].values())
    return {
        "success": summary["success"],
        "configuration": summary["configuration"],
        "limits": summary["limits"] + ("; --lift-limits shows the errors beyond them" if stopped else ""),
        "masses believed": None if scale == 1.0 else f"{100 * scale:g} % of each model's own",
        "share of the force": ", ".join(shares) or None,
        "picture": summary["picture"],
        "wall": f"{summary['wall_s']:.1f} s",
    }


def unrest(row: Row) -> str:
    """Remark if the step response has not settled, else empty."""
    return "not at rest at the end" if row.get("settled") is False else ""


def result(row: Row) -> str:
    """Fault of a law and its time, or the number of ticks in which limits acted; else empty."""
    if row["fault"]:
        return str(row["fault"]) + ("" if row["fault_s"] is None else f" at {row['fault_s']:.3f} s")
    acted = [f"{k.lower()} {n}" for k, n in row.get("limited_ticks", {}).items() if n]
    return f"limited ticks: {', '.join(acted)}" if acted else ""


def stage_title(name: str, stages: Sequence[str]) -> str:
    """Title of a signal path: `+` and the losses that this path adds to the path before it."""
    return name if name in (stages[0], stages[-1]) else f"+ {name}"


def _gains(gains: Row) -> str:
    def one(value: Any) -> str:
        if isinstance(value, list):
            return f"[{', '.join(map(one, value))}]"
        return value if isinstance(value, str) else f"{value:.4g}"

    return ", ".join(f"{key} {one(value)}" for key, value in gains.items())


def _at(path: str) -> Callable[[Any], str | Text]:
    def cell(row: Any) -> str | Text:
        found = row[1].get(path, {})
        fault = found.get("fault")
        return Text(fault, "red") if fault else figure(found.get("peak_leg_error_mm"), ".4f")

    return cell
