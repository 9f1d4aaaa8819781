"""What an interrupt says of what there is by then: the innermost word counts, and nothing is asked without one."""

from __future__ import annotations

import pytest

from hil.app.interrupted import leaving


@pytest.mark.parametrize(("own", "told"), [("", "a log"), ("at 2 s", "at 2 s")])
def test_an_interrupt_that_says_nothing_yet_says_what_there_is_and_one_that_does_keeps_its_words(own, told):
    with pytest.raises(KeyboardInterrupt) as interrupt, leaving(lambda: "nothing has moved"):  # noqa: SIM117
        with leaving(lambda: "a log"):
            raise KeyboardInterrupt(*([own] if own else []))
    assert str(interrupt.value) == told


def test_what_there_is_is_asked_for_at_the_interrupt_and_of_no_other_end():
    asked: list[str] = []

    def there():
        asked.append("asked")
        return "a log"

    with leaving(there):
        pass
    with pytest.raises(ValueError, match="wrong"), leaving(there):
        raise ValueError("wrong")
    assert asked == []
