"""What became of a stream of set-points: each was followed, refused, or never answered."""

import pytest

from hil.operate import client
from hil.operate.client import REFUSED, TAKEN, OperatorClient

NO = f"{REFUSED}out of reach"


class Heard(OperatorClient):
    """A client whose controller gives these answers, one list after each set-point, then one more."""

    def __init__(self, *answers):
        self.answers, self.said = list(answers), []

    def _send(self, line):
        self.said.append(line)
        return ""

    def _arrived(self):
        return self.answers.pop(0) if self.answers else []


@pytest.mark.parametrize(
    ("answers", "taken", "refused", "why"),
    [
        ([[TAKEN], [TAKEN], [TAKEN], [TAKEN]], 4, 0, ""),
        ([[], [], [], []], 0, 0, ""),
        ([[TAKEN], [], [], []], 1, 0, ""),
        ([[], [TAKEN], [NO], []], 1, 1, "out of reach"),
        ([[], [], [], [NO, NO]], 0, 2, "out of reach"),
        ([[NO], [NO], [NO], [NO]], 0, 4, "out of reach"),
        ([[], [TAKEN, TAKEN], [], [NO]], 2, 1, "out of reach"),
    ],
)
def test_set_points_without_an_answer_are_neither_followed_nor_refused(
    answers, taken, refused, why, monkeypatch
):
    monkeypatch.setattr(client, "ANSWER_S", 0.0)
    operator = Heard(*answers)
    found = operator.stream([(0.0, 0.0, 1.0)] * 4, 1e9)
    assert len(operator.said) == 4
    assert (found.sent, found.taken, found.refused, found.why) == (4, taken, refused, why)
