"""The platform is fixed to its legs at a machine on which nothing was found, and at no other."""

import pytest

from drivers.tick_columns import new_record
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.lab.bringup import command
from hil.lab.bringup.context import Finding, Request
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.ends import End
from hil.lab.bringup.procedure import Outcome
from hil.lab.bringup.store import Store

FOUND = (Finding("encoder_sign", (3,), "", ""), Finding("payload", (), "", ""))
ENDS = {
    "good": (Outcome(("scan",), ()), True),
    "one_leg": (Outcome(("scan",), FOUND[:1]), False),
    "the_platform": (Outcome(("scan",), FOUND[1:]), False),
    "stopped_with_findings": (Outcome((), FOUND, stopped="ids"), False),
    "stopped": (Outcome(("scan",), (), stopped="mounted"), False),
}


class Asked:
    """An operator who does at once what he is asked. Mutable state: what he was asked."""

    patience = 1.0

    def __init__(self) -> None:
        self.requests: list[Request] = []

    def consent(self, *_: str) -> bool:
        return True

    def tell(self, _text: str) -> None:
        pass

    def ask(self, request: Request) -> None:
        self.requests.append(request)

    def answer(self) -> float:
        return 0.0


@pytest.mark.parametrize("machine", [True, False])
@pytest.mark.parametrize("case", ENDS)
def test_nobody_is_told_to_fix_the_platform_to_legs_that_are_to_be_mended(
    case, machine, tmp_path, monkeypatch
):
    outcome, good = ENDS[case]
    monkeypatch.setattr(command, "bring_up", lambda _: outcome)
    monkeypatch.setattr(Drives, "step", lambda *_: new_record())
    c, operator = load("virtual"), Asked()
    line = type("Line", (), {"rate_Hz": 500.0})()
    said = type("Said", (), {"tick": None})()
    end, store = End(line, operator), Store(tmp_path / "s.json", {})
    found, _, why = command._proceed(c, build_protocol(c), end, store, said, hang=machine)
    assert (found, why) == (outcome, "")
    assert [request.act for request in operator.requests] == ["mount"] * (good and machine)
