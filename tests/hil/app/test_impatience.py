"""Each command interrupted at moments from its start to its end, as a terminal does it."""

from __future__ import annotations

import pytest

from tools.impatience.child import HIL, Outcome, perform
from tools.impatience.interrupts import BROAD, interrupted
from tools.impatience.judge import found_wrong

pytestmark = pytest.mark.long


@pytest.mark.parametrize("command", BROAD)
def test_an_interrupt_leaves_no_traceback_no_process_and_no_half_file(command, tmp_path):
    stock = tmp_path / "stock.mcap"
    assert perform((*HIL, "sim", "--duration", "1", "--log", str(stock)), tmp_path).code == 0
    wrong = [
        (case.moments_s, case.wrong, case.outcome.out, case.outcome.err)
        for case in interrupted(command, stock, tmp_path, 40)
        if case.wrong
    ]
    assert not wrong


def test_the_judge_sees_each_thing_that_is_left_behind(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG half")
    (tmp_path / "a.json").write_text("{")
    bad = Outcome(1, "", "Traceback (most recent call last)", ("a process",), 1.0, 1.0)
    wrong = found_wrong(bad, tmp_path, {130})
    assert [each.split(":")[0] for each in wrong] == [
        "says 'Traceback'", "exit code 1, allowed", "left running", "a.json", "a.png",
    ]  # fmt: skip
    assert found_wrong(Outcome(130, "", "", (), 1.0, 1.0), tmp_path, {130})[0] == "says nothing"
