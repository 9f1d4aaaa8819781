"""The file of a learned feed-forward: a YAML head in comment lines, then a CSV of leg forces over time.

The head says what the forces were learned on. A run on anything else is refused.
"""

import hashlib
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import ValidationError

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.files import read_regular
from hil.app.configuration import problems as translate
from hil.app.configuration.controller_file import controller_path
from hil.app.configuration.yaml_positions import Path as Key
from hil.app.configuration.yaml_positions import lines, parse
from hil.config.feedforward import FeedforwardHead, FeedforwardSettings, MadeFor
from hil.config.platform import PlatformSettings
from hil.config.reference import LiveReference, ReferenceSettings, SampledReference
from hil.control import ControllerSettings
from hil.control.state_space import StateSpaceSettings
from hil.loop.learned import LearnedForces

MOST_BYTES = 32 << 20
"""Some seven minutes at 1 kHz."""
MOST_HEAD = 100
"""Lines."""
COLUMNS = ("t_s", *(f"leg_{leg}_N" for leg in range(6)))
UNEVEN = 1e-6
"""Largest deviation of a time from its place, as a share of the step."""
BEGINNING = b"# Made by hil learn"
"""By which an earlier file of the command is known."""
DECIMALS = 4
"""Of a force in the file."""
_DIGITS = 16


def made_for(
    reference: ReferenceSettings, controller: ControllerSettings, platform: PlatformSettings, folder: Path
) -> MadeFor:
    """Return the fingerprints of what a feed-forward is learned on.

    The path, the law with what it believes, and the robot, all that they name in files included. How a file
    is called, and how a reference is evaluated, is not in them.

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
    """Return the file of a feed-forward, relative to the configuration's folder."""
    return folder / settings.file


def largest_written(limit_N: float) -> float:
    """Return the largest force that a file can hold which is not above a limit, N."""
    nearest = round(limit_N, DECIMALS)
    return nearest if nearest <= limit_N else round(nearest - 10.0**-DECIMALS, DECIMALS)


def feedforward_text(head: FeedforwardHead, tau: Array, start: int, step_s: float) -> str:
    """Return the text of a file: forces (n, 6) N from `start` steps of step_s on, to 0.1 mN."""
    body = io.StringIO()
    rows = np.column_stack([(start + np.arange(len(tau))) * step_s, tau])
    np.savetxt(body, rows, fmt=["%.9g"] + [f"%.{DECIMALS}f"] * 6, delimiter=",")
    written = np.loadtxt(io.StringIO(body.getvalue()), delimiter=",", ndmin=2)
    said = head.model_dump(mode="json") | {"digest": _digest_of(written)}
    top = yaml.safe_dump(said, sort_keys=False, allow_unicode=True, width=100)
    remark = f"{BEGINNING.decode()}: leg forces over the time of the reference, > 0 extends\n"
    return (
        remark
        + "".join(f"# {line}\n" for line in top.splitlines())
        + f"{','.join(COLUMNS)}\n{body.getvalue()}"
    )


def read_feedforward(raw: bytes, name: str) -> tuple[FeedforwardHead, Array, float, float]:
    """Return head, forces (n, 6) N, their first time and step in s; name stands for the file in messages.

    Raises ConfigurationError: another kind of file, a head with problems, another number of rows or another
    digest than it says, a value that is no finite number, or times without one step.
    """
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{name}: not UTF-8 text: {error.reason}") from None
    head, line, rest = _head(text, name)
    header, _, body = rest.partition("\n")
    if tuple(word.strip() for word in header.split(",")) != COLUMNS:
        raise ConfigurationError(
            f"{name}:{line}: the header must be {','.join(COLUMNS)}; given: {header[:200] or 'nothing'}"
        )
    table = _table(body, head.rows, line, name)
    start_s, end_s = float(table[0, 0]), float(table[-1, 0])
    step_s = (end_s - start_s) / (len(table) - 1)
    off = np.abs(table[:, 0] - start_s - step_s * np.arange(len(table)))
    if not step_s > 0.0 or start_s > 0.0 or off.max() > UNEVEN * step_s:
        row = int(off.argmax())
        raise ConfigurationError(
            f"{name}:{line + 1 + row}: t_s must begin at 0 or before, and rise by one step, here {step_s:g} s"
            f"; given: {table[row, 0]:.9g}"
        )
    if _digest_of(table) != head.digest:
        raise ConfigurationError(
            f"{name}: its forces are not those that were learned (digest {_digest_of(table)}, allowed: "
            f"{head.digest or 'none is given'}): it was changed since; copy it again or learn anew"
        )
    tau = np.ascontiguousarray(table[:, 1:])
    tau.flags.writeable = False
    return head, tau, start_s, step_s


def _table(body: str, rows: int, line: int, name: str) -> Array:
    """Return so many rows of the body, behind the header in this line, all of them finite."""
    if not body.strip():
        raise ConfigurationError(f"{name}:{line + 1}: no row follows the header, allowed: at least 2")
    try:
        table = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, comments=None)
    except ValueError as error:
        raise ConfigurationError(f"{name}: rows are counted from line {line + 1}: {error}") from None
    if table.shape[1] != len(COLUMNS) or len(table) < 2:
        raise ConfigurationError(
            f"{name}: {len(table)} rows of {table.shape[1]} values, allowed: at least 2 of {len(COLUMNS)}"
        )
    if len(table) != rows or not body.endswith("\n"):
        last = "whole" if body.endswith("\n") else "cut"
        raise ConfigurationError(
            f"{name}: {len(table)} rows, the last one {last}, allowed: {rows} whole ones, as its head says: "
            "a part of the file is missing, copy it again or learn anew"
        )
    if not np.isfinite(table).all():
        row, column = (int(k) for k in np.argwhere(~np.isfinite(table))[0])
        raise ConfigurationError(
            f"{name}:{line + 1 + row}: {COLUMNS[column]} must be a finite number; given: {table[row, column]}"
        )
    return np.asarray(table, np.float64)


def _head(text: str, name: str) -> tuple[FeedforwardHead, int, str]:
    """Return the head, the number of the line behind it, and the text from that line on."""
    top: list[str] = []
    rest = text
    while rest.startswith("#") and len(top) <= MOST_HEAD:
        line, _, rest = rest.partition("\n")
        top.append(line[2:])
    if len(top) < 2 or len(top) > MOST_HEAD:
        raise ConfigurationError(
            f"{name}: has no head, allowed: a file that `hil learn` wrote, which begins with "
            f"2 to {MOST_HEAD} lines of # and what it was learned on"
        )
    document = parse("\n".join(["#", *top[1:]]))
    found = list(document.problems)
    if document.value is not None:
        try:
            head = FeedforwardHead.model_validate_json(json.dumps(document.value), strict=True)
        except ValidationError as error:
            found += translate.problems(error, document, FeedforwardHead.model_json_schema())
    if found:
        raise ConfigurationError(*lines(found, name))
    return head, len(top) + 1, rest


def learned_forces(
    settings: FeedforwardSettings | None,
    reference: ReferenceSettings,
    controller: ControllerSettings,
    platform: PlatformSettings,
    folder: Path,
) -> LearnedForces | None:
    """Return the forces that a configuration names; None where it names none.

    Raises ConfigurationError as `read_feedforward`; and where they were learned on another reference,
    controller or platform, or are more than `feedforward.limit_N`.
    """
    if settings is None:
        return None
    path = feedforward_path(settings, folder)
    try:
        raw = read_regular(path, MOST_BYTES)
    except FileNotFoundError:
        raise ConfigurationError(
            f"no such file, allowed: one that `hil learn` wrote, given: {settings.file} (looked for {path})"
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
                f"wrong on this one. Take section feedforward out, run once, and learn anew from that log"
            )
    peak = float(np.abs(tau).max())
    if peak > settings.limit_N:
        raise ConfigurationError(
            f"{path}: its largest force is above feedforward.limit_N, allowed: up to "
            f"{settings.limit_N:.15g} N, given: {peak:.15g} N"
        )
    return LearnedForces(tau, start_s, step_s, settings.fade_s)


def usable_feedforward(
    feedforward: FeedforwardSettings | None,
    reference: ReferenceSettings,
    controller: ControllerSettings,
    platform: PlatformSettings,
    folder: Path | None,
) -> Iterator[tuple[Key, str]]:
    """Refuse a feed-forward that was learned on something else, and one where set-points are not known."""
    if feedforward is None:
        return
    if isinstance(reference, LiveReference):
        message = "where set-points will send a live reference is not known, allowed with it: leave it out"
        yield ("feedforward",), message
    elif folder is not None:
        try:
            learned_forces(feedforward, reference, controller, platform, folder)
        except ConfigurationError as error:
            yield ("feedforward", "file"), str(error)
