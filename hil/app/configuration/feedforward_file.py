"""File of a learned feed-forward: a YAML head in comment lines, then a CSV of leg forces over time.

The head records what the forces were learned on. A run on anything else is refused.
"""

import hashlib
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.files import read_regular
from hil.app.configuration.controller_file import controller_path
from hil.app.configuration.problems import checked
from hil.app.configuration.yaml_positions import parse
from hil.config.feedforward import FeedforwardHead, FeedforwardSettings, MadeFor
from hil.config.platform import PlatformSettings
from hil.config.reference import ReferenceSettings, SampledReference
from hil.control import ControllerSettings
from hil.control.state_space import StateSpaceSettings
from hil.loop.reference import LearnedForces

MOST_BYTES = 32 << 20
"""About seven minutes at 1 kHz."""
_HEAD = re.compile(r"(?:#.*\n){2,100}(?!#)")
COLUMNS = ("t_s", *(f"leg_{leg}_N" for leg in range(6)))
BEGINNING = b"# Made by hil learn"
"""First words of the command's files, to recognise an earlier one."""
DECIMALS = 4
"""Decimals of a force in the file."""
_DIGITS = 16


def made_for(
    reference: ReferenceSettings, controller: ControllerSettings, platform: PlatformSettings, folder: Path
) -> MadeFor:
    """Fingerprints of the reference, controller and platform that a feed-forward belongs to.

    They cover the path, the law with its model, and the robot, including the content of their files. They
    omit the names of the files and the evaluation of the reference.

    Raises ConfigurationError: a file cannot be read.
    """
    path = data = b""
    if isinstance(reference, SampledReference):
        path = _content(folder / reference.path)
    if isinstance(controller, StateSpaceSettings):
        data = _content(controller_path(controller, folder))
    home = platform.home.model_dump(mode="json")
    return MadeFor(
        reference=_digest([_plain(reference, "evaluation", "path"), home], path),
        controller=_digest(_plain(controller, "controller_file"), data),
        platform=_digest(_plain(platform, "home"), b""),
    )


def _content(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None


def _plain(section: Any, *without: str) -> Any:
    return section.model_dump(mode="json", exclude_defaults=True, exclude=set(without))


def _digest(data: Any, content: bytes) -> str:
    text = json.dumps(data, sort_keys=True)
    return hashlib.sha256(text.encode() + b"\0" + content).hexdigest()[:_DIGITS]


def _digest_of(table: Array) -> str:
    return hashlib.sha256(table.astype("<f8").tobytes()).hexdigest()[:_DIGITS]


def feedforward_path(settings: FeedforwardSettings, folder: Path) -> Path:
    """Path of a feed-forward file, relative to the configuration's folder."""
    return folder / settings.file


def largest_written(limit_N: float) -> float:
    """Largest force, N, not above a limit that a feed-forward file can hold with its DECIMALS."""
    nearest = round(limit_N, DECIMALS)
    return nearest if nearest <= limit_N else round(nearest - 10.0**-DECIMALS, DECIMALS)


def feedforward_text(head: FeedforwardHead, tau: Array, start: int, step_s: float) -> str:
    """Text of a feed-forward file: forces (n, 6) N from `start` steps of step_s on, to 0.1 mN."""
    body = io.StringIO()
    rows = np.column_stack([(start + np.arange(len(tau))) * step_s, tau])
    np.savetxt(body, rows, fmt=["%.9g"] + [f"%.{DECIMALS}f"] * 6, delimiter=",")
    written = np.loadtxt(io.StringIO(body.getvalue()), delimiter=",", ndmin=2)
    header = head.model_dump(mode="json") | {"digest": _digest_of(written)}
    top = yaml.safe_dump(header, sort_keys=False, allow_unicode=True, width=100)
    remark = f"{BEGINNING.decode()}: leg forces over the time of the reference, > 0 extends\n"
    return (
        remark
        + "".join(f"# {line}\n" for line in top.splitlines())
        + f"{','.join(COLUMNS)}\n{body.getvalue()}"
    )


def read_feedforward(raw: bytes, name: str) -> tuple[FeedforwardHead, Array, float, float]:
    """(head, forces (n, 6) N, first time s, step s) of a feed-forward file; name: for messages.

    Raises ConfigurationError: another kind of file, a head with problems, or rows that do not match the
    digest in the head.
    """
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{name}: not UTF-8 text: {error.reason}") from None
    top = _HEAD.match(text)
    if top is None:
        raise ConfigurationError(
            f"{name}: has no head, allowed: a file of `hil learn`, which begins with "
            "2 to 100 comment lines (#)"
        )
    header = "\n".join(["#", *(line[2:] for line in top[0].split("\n")[1:])])
    head = checked(FeedforwardHead, parse(header), name)
    try:
        rows = io.StringIO(text[top.end() :].partition("\n")[2] or "nan")
        table = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
    except ValueError as error:
        raise ConfigurationError(f"{name}: {error}, in the rows below the head") from None
    learned = table.shape == (head.rows, len(COLUMNS)) and _digest_of(table) == head.digest
    if not (learned and np.isfinite(table).all() and table[-1, 0] > table[0, 0]):
        raise ConfigurationError(
            f"{name}: {len(table)} rows with the digest {_digest_of(table)}, allowed: {head.rows} rows "
            f"with {head.digest or 'none'}: the file was truncated or changed; copy it again or learn again"
        )
    start_s, end_s = float(table[0, 0]), float(table[-1, 0])
    tau = np.ascontiguousarray(table[:, 1:])
    tau.flags.writeable = False
    return head, tau, start_s, (end_s - start_s) / (len(table) - 1)


def learned_forces(
    settings: FeedforwardSettings | None,
    reference: ReferenceSettings,
    controller: ControllerSettings,
    platform: PlatformSettings,
    folder: Path,
) -> LearnedForces | None:
    """Learned feed-forward forces of a configuration; None without section `feedforward`.

    Raises ConfigurationError as `read_feedforward`; also for forces that were learned on another reference,
    controller or platform, or that exceed `feedforward.limit_N`.
    """
    if settings is None:
        return None
    path = feedforward_path(settings, folder)
    try:
        raw = read_regular(path, MOST_BYTES)
    except FileNotFoundError:
        raise ConfigurationError(
            f"no such file, allowed: a file of `hil learn`, given: {settings.file} (looked for {path})"
        ) from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    head, tau, start_s, step_s = read_feedforward(raw, str(path))
    now = made_for(reference, controller, platform, folder)
    for what in MadeFor.model_fields:
        there, here = getattr(head.made_for, what), getattr(now, what)
        if there != here:
            raise ConfigurationError(
                f"{path}: was learned on another {what} (fingerprint {there}, here {here}): its forces are "
                f"wrong here. Remove section feedforward, run once, and learn again from that log"
            )
    peak = float(np.abs(tau).max())
    if peak > settings.limit_N:
        raise ConfigurationError(
            f"{path}: its largest force is above feedforward.limit_N, allowed: up to "
            f"{settings.limit_N:.15g} N, given: {peak:.15g} N"
        )
    return LearnedForces(tau, start_s, step_s, settings.fade_s)
