"""Campaign files and helpers shared by several tests."""

import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
from contextlib import closing, contextmanager, suppress
from pathlib import Path

ROOT = Path(__file__).parents[4]

SMALL = """
kind: campaign
name: small
configuration: virtual
duration_s: 0.05
sample:
  method: sobol
  count: 2
  seed: 3
  axes:
    friction_N: {key: plant.model.coulomb_friction_N, uniform: [0, 100]}
grid:
  fault:
    faults:
      none: []
      jump: ["encoder_jump leg=1 mode=RELEASING by=5e-3"]
"""
"""Four rows; the second and the last end in a fault."""


MANY = SMALL.replace("count: 2", "count: 40")
"""Eighty rows: two workers take some seconds."""


def written(folder, text, name="c.yaml"):
    """Write a campaign file and return its path."""
    path = folder / name
    path.write_text(textwrap.dedent(text))
    return path


@contextmanager
def started(plan, out, *words):
    """Start `hil campaign` in its own process group, which is killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hil.cli", "campaign", str(plan.path), "--out", str(out), *words],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_for_a_row(out, process, within_s=300.0):
    """Wait until the first row is on the disk."""
    end = time.monotonic() + within_s
    while not _has_rows(out / "campaign.sqlite"):
        assert process.poll() is None, "the process ended too early"
        assert time.monotonic() < end
        time.sleep(0.02)


def _has_rows(database):
    with (
        suppress(sqlite3.OperationalError),
        closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as db,
    ):
        return db.execute("SELECT count(*) FROM rows").fetchone()[0] > 0
    return False


def kill_thrice(plan, out, chance, *words):
    """Start a campaign three times and kill -9 it at a random instant, the first time while rows run.

    Its workers must end with it: no process of the group remains.
    """
    for k in range(3):
        with started(plan, out, *words) as process:
            if k == 0:
                wait_for_a_row(out, process)
            time.sleep(chance.uniform(0.0, 1.0) if k == 0 else chance.uniform(0.5, 4.0))
            assert process.poll() is None, "the process ended before it could be killed"
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            assert _gone(process.pid, 20.0)


def _gone(group, within_s):
    """True if all processes of a group end within some time."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False
