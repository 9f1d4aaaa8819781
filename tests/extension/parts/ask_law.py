"""Run in the copy: what it makes of the new laws, as one line of JSON."""

import json
from pathlib import Path

from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.schema import schema
from hil.app.stability.command import judge
from hil.cli import main
from hil.study.compare.laws import chosen

virtual = load("virtual").text
begin, end = virtual.index("\ncontroller:") + 1, virtual.index("\nengage:") + 1


def bench(law):
    return f"{virtual[:begin]}controller: {law}\n{virtual[end:]}"


def problem(text):
    try:
        loads(text, "my.yaml", Path())
    except ConfigurationError as error:
        return str(error)


critical, slow = "{law: critical, stiffness_N_m: 1e6}", "{law: slow, wn_rad_s: 40, factor: 2}"
a, b = (loads(bench(law), "my.yaml", Path()) for law in (critical, slow))
Path("my.yaml").write_text(bench(critical))
ran = CliRunner().invoke(
    main, ["sim", "my.yaml", "--duration", "0.5", "--log", "my.mcap", "--json", "my.json"]
)
compared = chosen(load("virtual"))
try:
    chosen(load("virtual"), ["slow"])
except ConfigurationError as error:
    left_out = str(error)
print(
    json.dumps(
        {
            "schema": sorted(
                name for name in schema()["$defs"] if name in ("CriticalSettings", "SlowSettings")
            ),
            "wrong": problem(bench("{law: critical, stiffness_N_m: -1}")),
            "ran": [ran.exit_code, ran.output, Path("my.json").read_text()],
            "verdicts": [judge(c, quick=True).line for c in (a, b)],
            "checked": [inspect(c).lines for c in (a, b)],
            "compared": {name: settings.model_dump(mode="json") for name, settings in compared.items()},
            "left_out": left_out,
        }
    )
)
