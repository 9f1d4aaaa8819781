"""Jobs in processes: each has one outcome, whichever dies, and none is made long before its turn."""

import os
from functools import partial
from operator import call

from hil.app.workers import AHEAD, perform


class Work(list):  # type: ignore[type-arg]
    """Jobs, and how many of them were asked for."""

    made = 0

    def __iter__(self):
        for job in super().__iter__():
            self.made += 1
            yield job


def test_a_process_that_dies_takes_few_jobs_with_it_and_none_of_a_million_is_made_before_its_turn():
    work = Work([os.getpid] * 40)
    work[5] = partial(os._exit, 1)
    outcomes = perform(work, call, lambda _: "died", 2, None)
    found = [next(outcomes)]
    assert work.made <= 2 * AHEAD + 1
    found += outcomes
    assert len(found) == 40
    assert found.count("died") == 1
    alone = 2 * AHEAD  # as many as were under way
    assert len(set(found)) <= 2 + alone + 2
