"""Jogging: one axis or leg at set-up speed from hold, while the operator's words keep coming.

Pure: it judges by ticks. Before each tick the pose is judged at which the platform would come to rest if it
went on for this tick and then braked. Where that is refused it brakes at once, to the rest that was judged a
tick before: so each pose on the way has been judged, and it stops inside.
"""

from collections.abc import Callable
from math import radians
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.signals import Refusal
from hil.config.operator import OperatorSettings
from hil.loop.jog_paths import JogPath, jog_path, setup_share
from hil.loop.motion import Motion
from hil.mathematics.rotations import rotation_vector_kernel
from hil.robot.geometry import Platform
from hil.signals import JOG_NAMES, Order, explain
from hil.trajectory.path import PoseSample

WORD_S = 0.1
"""A jog whose word is not heard again for so long ends."""
ON_HOLD = "jog: only on hold, in mode TRACKING: say hold first"
NOT_RESTING = "jog: the platform still comes to rest: wait for it"
NO_KEY = "jog: the key is not held (operator.deadman_s): hold it while you jog"
SUDDEN = (
    "a leg's force could change by more than limits.force_window_N within 250 ms: lower the set-up speed, or "
    "lengthen engage.stop_s"
)
LIVE = "jog: the reference is live, and moves to set-points alone: say start, then setpoint"


class Word(NamedTuple):
    """The last jog word."""

    axis: int
    """Index in JOG_NAMES."""
    fraction: float
    """-1 .. 1 of the set-up speed."""
    tick: int

    @property
    def way(self) -> tuple[int, int]:
        """Axis and direction: -1, 1, or 0 where it lets go."""
        return self.axis, (self.fraction > 0.0) - (self.fraction < 0.0)


class Jogging:
    """Moves the platform along one axis or leg, and stops it before a limit.

    Mutable state: the last word, the path it is on with its way, and the way on which a limit stopped it with
    the reason, until the words cease.
    """

    def __init__(
        self,
        settings: OperatorSettings,
        rate_Hz: float,
        platform: Platform,
        admission: Callable[[Array], int] | None,
        too_sudden: Callable[[PoseSample, float], bool],
    ) -> None:
        """Take the judge of poses (6,) m, rad: bits of Refusal; None: the reference is live.

        too_sudden: the judge of samples at a share of their speed, by what forces change by.
        """
        self._speeds = settings.setup_speed_m_s, radians(settings.setup_speed_deg_s)
        self._patience = max(1, int(WORD_S * rate_Hz + 1e-9))
        self._platform, self._admission, self._too_sudden = platform, admission, too_sudden
        self.reset()

    def reset(self) -> None:
        """Back to the start: no word."""
        self._word: Word | None = None
        self._path: JogPath | None = None
        self._way: tuple[int, int] | None = None
        self._stopped: Word | None = None
        self.refusal = ""
        """Why the jog does not go on; empty unless a limit has stopped it."""

    @property
    def waits(self) -> bool:
        """Whether a word has been taken that moves the platform yet to come."""
        return self._word is not None

    def let_go(self) -> None:
        """Come to rest."""
        self._word = self._stopped = None
        self.refusal = ""

    def take(self, order: Order, tick: int, motion: Motion, *, on_hold: bool, key: bool) -> str:
        """Take a jog word; return why it is refused, empty where it counts."""
        if self._admission is None:
            return LIVE
        if not on_hold:
            return ON_HOLD
        if not key:
            return NO_KEY
        if not motion.resting and motion.trajectory is not self._path:
            return NOT_RESTING
        axis, fraction = order.numbers
        word = Word(int(axis), fraction, tick)
        stopped = self._stopped
        if stopped is not None and stopped.way == word.way and tick - stopped.tick < self._patience:
            self._stopped = word
            return self.refusal
        self.let_go()
        self._word = word
        return ""

    def step(self, tick: int, motion: Motion, *, key: bool) -> None:
        """Set how the jog goes on from a tick on, to which the motion has been advanced."""
        word = self._word
        if word is not None and not (key and word.fraction and tick - word.tick < self._patience):
            word = self._word = None
        under_way = motion.trajectory is self._path
        speed = 0.0
        if word is not None and under_way and self._way == word.way:
            assert self._path is not None
            speed = self._judged(self._path, word, tick, motion, 0.0)
        elif word is not None and motion.resting:
            path = self._begun(word, motion.sample(tick))
            speed = self._judged(path, word, tick, motion, motion.time(tick))
            if speed > 0.0:
                motion.leave(path, tick)
                self._path, self._way, under_way = path, word.way, True
        if under_way:
            motion.aim(tick, speed, go=True)

    def _begun(self, word: Word, here: PoseSample) -> JogPath:
        return jog_path(self._platform, here, word.axis, self._speeds, word.fraction)

    def _judged(self, path: JogPath, word: Word, tick: int, motion: Motion, zero_s: float) -> float:
        """Return the speed to go on at, 0 .. 1 of the path's; 0 where a limit is ahead, which is noted.

        zero_s: the motion's time at which the path begins.
        """
        assert self._admission is not None
        here = path.ahead(motion.time(tick) - zero_s)
        speed = abs(word.fraction) * self._share(here)
        rest = path.ahead(motion.rests_at(tick, speed) - zero_s)
        slower = min(speed, abs(word.fraction) * self._share(rest))
        if slower < speed:
            speed, rest = slower, path.ahead(motion.rests_at(tick, slower) - zero_s)
        against = explain(Refusal.CONDITION)
        if rest is not None:
            against = explain(self._admission(np.concatenate([rest.p, rotation_vector_kernel(rest.R)])))
            if not against and self._too_sudden(rest, speed):
                against = SUDDEN
        if not against:
            return speed
        self._word, self._stopped = None, word
        self.refusal = f"jog {JOG_NAMES[word.axis]}: it stops, since beyond, {against}"
        return 0.0

    def _share(self, sample: PoseSample | None) -> float:
        return 1.0 if sample is None else setup_share(sample, self._speeds)
