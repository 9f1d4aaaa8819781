"""What the rules on encoders remember: of which leg, until when, and what they forget."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.signals import Doubt
from hil.safety import encoder_kernels
from tests.hil.encoder_bench import BOTH_SIGNS, Bench, calm, doubted, six


@pytest.mark.parametrize("name", ["gaps", "travel", "excused"])
def test_a_run_that_waits_anew_forgets_the_doubt_and_all_sums_that_led_to_it(name):
    memory = SimpleNamespace(
        doubt=2,
        doubted=9,
        doubt_value=0.5,
        doubt_limit=0.25,
        gaps=six(1.0),
        travel=six(2.0),
        excused=six(3.0),
    )
    encoder_kernels.forget_doubt(memory)
    assert (memory.doubt, memory.doubted, memory.doubt_value, memory.doubt_limit) == (0, 0, 0.0, 0.0)
    assert not np.any(getattr(memory, name))


@BOTH_SIGNS
@pytest.mark.parametrize(("leap", "doubts"), [(0.9e-9, False), (1.1e-9, True)])
def test_where_nothing_explains_a_leap_a_billionth_of_a_metre_per_second_is_none(leap, doubts, sign):
    bench = Bench(open_ticks=0)
    bench.ticks(4)
    tick = bench.tick(rate=six(sign * leap, 2))
    assert doubted(tick, Doubt.LEAP, 2, sign * leap, 1e-9) if doubts else calm(tick)
