"""Run in the copy: what it makes of the new law, as one line of JSON."""

import json
from pathlib import Path

from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.schema import schema
from hil.app.stability.command import judge
from hil.cli import main
from hil.study.compare.laws import chosen

virtual = load("virtual").text
begin, end = virtual.index("\ncontroller:") + 1, virtual.index("\nengage:") + 1


def text(stiffness):
    law = f"controller: {{law: critical, stiffness_N_m: {stiffness}}}"
    return f"{virtual[:begin]}{law}\n{virtual[end:]}"


wrong = ""
try:
    loads(text(-1), "my.yaml", Path())
except ConfigurationError as error:
    wrong = str(error)
Path("my.yaml").write_text(text(1e6))
words = ["sim", "my.yaml", "--duration", "0.5", "--log", "my.mcap", "--json", "my.json"]
ran = CliRunner().invoke(main, words)
compared = chosen(load("virtual"))
found = {
    "schema": list(schema()["$defs"]),
    "wrong": wrong,
    "ran": [ran.exit_code, ran.output, Path("my.json").read_text()],
    "verdict": judge(load("my.yaml"), quick=True).line,
    "compared": {name: settings.model_dump(mode="json") for name, settings in compared.items()},
}
print(json.dumps(found))
