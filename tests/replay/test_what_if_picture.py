"""The picture of a what-if: what it draws of each leg, block by block, and which file it replaces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import ROW
from hil.study.what_if import picture
from hil.study.what_if.command import new_picture
from hil.study.what_if.picture import Forces

RNG = np.random.default_rng(3)


def test_each_leg_has_both_forces_and_the_answer_less_the_recorded_one_over_the_time_of_the_log(monkeypatch):
    drawn: dict[str, Any] = {}
    monkeypatch.setattr(picture, "draw", lambda titles, panels, *_, **__: drawn.update(panels=panels))
    there, here = RNG.normal(size=(7, 6)), RNG.normal(size=(7, 6))
    forces = Forces()
    block = np.zeros((2, 4), ROW)
    for begin, end in ((0, 4), (4, 7)):
        recorded, answered = block[:, : end - begin]
        recorded["t_ns"] = 5_000_000_000 + 1_000_000 * np.arange(begin, end)
        recorded["tau"], answered["tau"] = there[begin:end], here[begin:end]
        forces.keep(recorded, answered)
    block["tau"], block["t_ns"] = 0.0, 0
    forces.draw(Path("a.png"), "")
    *legs, differences = drawn["panels"]
    assert (len(legs), len(differences)) == (6, 6)
    for leg, (recorded, answered) in enumerate(legs):
        assert (recorded.label, answered.label) == ("recorded", "what-if")
        np.testing.assert_array_equal(recorded.signal.values, there[:, leg])
        np.testing.assert_array_equal(answered.signal.values, here[:, leg])
        assert (recorded.log, answered.log, differences[leg].log) == (0, 1, 0), "each side in its own colour"
        np.testing.assert_allclose([recorded.t, answered.t], [1e-3 * np.arange(7)] * 2, atol=1e-12)
        np.testing.assert_array_equal(differences[leg].signal.values, here[:, leg] - there[:, leg])
        np.testing.assert_allclose(differences[leg].t, 1e-3 * np.arange(7), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "own", "foreign"),
    [
        ("a.png", b"\x89PNG\r\n rest", b"<?xml version"),
        ("a.PNG", b"\x89PNG\r\n rest", b"notes"),
        ("a.svg", b"<?xml version", b"\x89PNG\r\n rest"),
    ],
)
def test_an_earlier_picture_of_its_kind_is_replaced_and_no_other_file_is(tmp_path, name, own, foreign):
    path = tmp_path / name
    new_picture(path)
    path.write_bytes(own)
    new_picture(path)
    path.write_bytes(foreign)
    with pytest.raises(
        LogError, match=rf"--plot .*{name}: exists, is not an? \w+ picture and is not overwritten"
    ):
        new_picture(path)
