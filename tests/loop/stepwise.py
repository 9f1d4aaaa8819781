"""A lockstep that runs the parts of a tick one by one, so that a test can intervene."""

from dataclasses import dataclass

from drivers.arrays import Rows
from hil.app.sim.lockstep import Lockstep
from hil.app.sim.wire_kernels import answer, begin, command, heard_by, pass_on
from hil.signals import Operator, Order, SetPoint, TickInput, TickOutput


@dataclass
class Stepwise(Lockstep):
    """Both ends, one tick at a time; faults that wait for a mode never start."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.window_ns = round(self.feedback_window_s * 1e9)
        self.compute_ns = round(self.compute_us * 1e3) if self.timings[0] else 0

    def step(
        self,
        operator: tuple[Operator, ...] = (),
        setpoints: tuple[SetPoint, ...] = (),
        orders: tuple[Order, ...] = (),
    ) -> tuple[TickInput, Rows, TickOutput]:
        """Advance both ends by one tick."""
        self.tick = tick = self.tick + 1
        t_ns, w, opening = tick * self.period_ns, self.wires.record, self.cycle.begin(tick)
        heard = self.exchange(t_ns, opening)
        inp = TickInput(
            tick,
            t_ns,
            sync_skew_ns=int(w["skew_ns"]),
            frames=heard,
            latch_ns=tuple(w["latch_ns"].tolist()),
            operator=operator,
            setpoints=setpoints,
            orders=orders,
        )
        out = self.cycle.step(inp)
        self.send(out.frames, int(w["step_ns"]) + self.compute_ns, t_ns + self.period_ns - 1)
        return inp, opening, out

    def exchange(self, t_ns: int, opening: Rows) -> Rows:
        """Deliver SYNC to the drives, and their answers to the controller; return the received frames."""
        wires, w, nodes = self.wires, self.wires.record, self.nodes
        deadline_ns = t_ns + self.window_ns
        if self.cycle.parts.protocol.traits.unasked_s > 0.0:
            heard = heard_by(wires.record, t_ns)
            replies = nodes.advance(t_ns, wires.commands[:heard])
            while status := pass_on(wires.record, replies, t_ns, heard):
                wires.settle(status, replies)
        while status := begin(wires.record, opening, t_ns, deadline_ns):
            wires.settle(status, opening)
        replies = nodes.advance(int(w["synced_ns"]), wires.commands[: w["commands"]])
        while status := answer(wires.record, replies, self.tick, t_ns, deadline_ns):
            wires.settle(status, replies)
        heard_frames: Rows = wires.late[: w["taken"]].copy()
        return heard_frames

    def send(self, frames: Rows, t_ns: int, until_ns: int) -> None:
        """Queue the controller's command."""
        while status := command(self.wires.record, frames, t_ns, until_ns):
            self.wires.settle(status, frames)
