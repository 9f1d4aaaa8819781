"""A campaign as JUnit XML: one case a row."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from drivers.errors import LogError
from hil.app.campaign.plan import Plan
from hil.app.campaign.rates import shown, why
from hil.app.campaign.show import rerun_command
from hil.app.files import write_whole


def write_junit(path: Path, plan: Plan, summary: dict[str, Any], folder: Path | None = None) -> None:
    """Write a case a row, named by its values. Raises LogError if the file cannot be written."""
    suite = ET.Element(
        "testsuite",
        name=f"hil campaign {plan.name}",
        tests=str(summary["rows"]),
        failures=str(summary["failed"]),
    )
    for row in summary["matrix"]:
        values = " ".join(f"{name}={shown(row[name])}" for name in plan.subject.axes)
        case = ET.SubElement(suite, "testcase", classname=plan.name, name=f"row {row['row']} {values}")
        if not row["passed"]:
            failure = ET.SubElement(case, "failure", message=_plain(why(row, plan.subject.limits)))
            failure.text = _plain(
                "\n".join(filter(None, (row["trouble"], rerun_command(plan, row["row"], folder))))
            )
    ET.indent(suite)
    text = ET.tostring(suite, encoding="unicode", xml_declaration=False)
    try:
        write_whole(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')
    except OSError as error:
        raise LogError(f"--junit {path}: cannot be written: {error.strerror}") from None


def _plain(text: str) -> str:
    """Return a text without the signs that XML 1.0 cannot have."""
    return "".join(sign if sign.isprintable() or sign == "\n" else " " for sign in text)
