"""Run of a log, as far as it can be read, for the pages about one run and about two."""

from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import ConfigurationError, LogError
from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration, loads
from hil.app.files import printable
from hil.app.readable import readable
from hil.app.replay import refuse_unread, run_of
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study.log_columns import seconds
from hil.study.report.story import Failure, failure_of


class Run(NamedTuple):
    """A run and its log."""

    name: str
    """File name of the log."""
    log: Log
    rows: Rows
    remark: str
    """What is missing in the log; empty for a whole one."""
    c: Configuration | None
    why_not: str
    """Why there is no configuration."""
    story: Failure
    rate_Hz: float

    @property
    def t(self) -> Array:
        """Time (n,), s, from the first tick in TRACKING, or from the first row."""
        t = seconds(self.rows)
        return t - float(t[np.argmax(self.rows["mode"] == Mode.TRACKING)])

    @property
    def verdict(self) -> str:
        """What went wrong, and what is missing in the log."""
        return "; ".join(filter(None, (self.story.headline, self.remark))) or "no fault"

    @property
    def title(self) -> str:
        """Kind, configuration, law, rate and begin, as text."""
        started = datetime.fromtimestamp(
            (self.log.epoch_ns + int(self.rows["t_ns"][0])) // 1_000_000_000, UTC
        )
        words = [
            f"hil {self.log.metadata[IDENTITY]['kind']}",
            "" if self.c is None else self.c.name,
            "" if self.c is None else f"law {self.c.controller.law}",
            f"{self.rate_Hz:g} Hz",
            "simulated time" if self.log.lockstep else f"real time, begun {started:%Y-%m-%dT%H:%M:%SZ}",
        ]
        return ", ".join(filter(None, words))


def read(path: Path) -> Run:
    """Run of a log. Raises LogError: not a log of `hil run` or `hil sim`, or without a tick."""
    log, rows, remark = readable(path)
    rate_Hz = run_of(log, path, ["rate_Hz"])["rate_Hz"]
    refuse_unread(log)
    if not len(rows):
        raise LogError("; ".join(filter(None, (f"{path}: has no tick to report", remark))))
    c, why_not = _configuration(log)
    story = failure_of(log.metadata, rows, rate_Hz)
    return Run(printable(path.name), log, rows, remark, c, why_not, story, rate_Hz)


def _configuration(log: Log) -> tuple[Configuration | None, str]:
    """(configuration of the run, ""), or (None, reason) if the log's configuration cannot be read."""
    try:
        return loads(log.configuration, f"{log.path}:config.yaml", files=log.attachments), ""
    except (LogError, ConfigurationError) as error:
        first = str(error).partition("\n")[0]
        return None, f"no limits, bus load and 3D view, because the configuration cannot be read: {first}"
