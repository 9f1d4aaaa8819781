"""Write the present results of the golden cases into expected.json; existing cases are not changed.

python -m tests.golden.freeze                   # adds the missing cases
python -m tests.golden.freeze --replace NAME    # replaces one case
python -m tests.golden.freeze --check           # runs all and compares; writes nothing
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from hil.record import environment
from tests.golden.cases import CASES
from tests.golden.runner import differences, digests, replayed, run

EXPECTED = Path(__file__).with_name("expected.json")
CPU = environment()["cpu"]


def expected() -> dict[str, Any]:
    """Frozen results by case name, and the CPU on which they were computed."""
    found: dict[str, Any] = json.loads(EXPECTED.read_text(encoding="utf-8"))
    return found


def text_of(kept: dict[str, Any]) -> str:
    """Text of the file: one line per case, so that a diff shows the changed case."""
    lines = [f"{json.dumps(name)}: {json.dumps(kept[name])}" for name in sorted(kept)]
    return f'{{"cpu": {json.dumps(CPU)},\n"cases": {{\n' + ",\n".join(lines) + "\n}}\n"


def frozen(name: str) -> dict[str, Any]:
    """Run a case. Raises ValueError if it does not replay, or if faults or commands were not reached."""
    begun = time.process_time()
    trace = run(CASES[name])
    comparison = replayed(CASES[name], trace)
    found = digests(trace)
    s, faults = time.process_time() - begun, ",".join(found["faults"])
    print(f"{s:5.2f} s  {found['ticks']:5d}  {name}: {found['modes']}  {faults}", flush=True)
    if not comparison.exact:
        raise ValueError(f"{name}: does not replay: {'; '.join(map(str, comparison.first))}")
    if trace.unmet:
        raise ValueError(f"{name}: not reached: {', '.join(trace.unmet)}")
    return found


def main() -> None:
    """Add the missing cases, or replace or check some."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--replace", action="append", default=[], choices=list(CASES), metavar="NAME")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    kept: dict[str, Any] = expected() if EXPECTED.exists() else {"cpu": CPU, "cases": {}}
    cases = kept["cases"]
    if kept["cpu"] != CPU:
        sys.exit(f"expected.json is of {kept['cpu']}, this is {CPU}: columns would not be comparable")
    if gone := sorted(set(cases) - set(CASES)):
        sys.exit(f"expected.json has cases that the table lacks: {', '.join(gone)}")
    problems = []
    for name in CASES if options.check else [name for name in CASES if name not in cases] + options.replace:
        try:
            found = frozen(name)
        except ValueError as error:
            problems.append(str(error))
            continue
        if options.check:
            problems += [f"{name}: {each}" for each in differences(cases[name], found)]
        else:
            cases[name] = found
    if not options.check:
        EXPECTED.write_text(text_of(cases), encoding="utf-8")
    sys.exit("\n".join(problems) or None)


if __name__ == "__main__":
    main()
