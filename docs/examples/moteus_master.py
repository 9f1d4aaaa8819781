"""A controller for six moteus drives, in the package moteus over python-can: lifts all legs, then stops them.

Start `hil plant FILE`, then `python docs/examples/moteus_master.py CHANNEL [INTERFACE]`.
"""

import asyncio
import math
import sys
import time

import moteus

CHANNEL = sys.argv[1]
INTERFACE = (*sys.argv[2:], "localcan")[0]
SCREW_M, TIMEOUT_S = 0.02, 0.2
N_PER_NM = 2 * math.pi / SCREW_M
R = moteus.Register


async def main() -> None:
    """Move the legs by 20 mm."""
    bus = moteus.PythonCan(interface=INTERFACE, channel=CHANNEL, fd=True, ignore_config=True)
    drives = [moteus.Controller(id=node, transport=bus) for node in range(1, 7)]
    heard = await bus.cycle([drive.make_stop(query=True) for drive in drives])  # clears faults
    start = {reply.id: SCREW_M * reply.values[R.POSITION] for reply in heard}
    length, rate = dict(start), dict.fromkeys(start, 0.0)
    begun = time.monotonic()
    while (share := (time.monotonic() - begun) / 0.8) < 1.5:
        commands = []
        for drive in drives:
            goal = start[drive.id] + 0.02 * min(1.0, share)
            force = 2e4 * (goal - length[drive.id]) - 4e3 * rate[drive.id]
            commands.append(
                drive.make_position(
                    position=math.nan, velocity=0.0, kp_scale=0.0, kd_scale=0.0,  # torque alone
                    feedforward_torque=force / N_PER_NM, maximum_torque=7.0,
                    watchdog_timeout=TIMEOUT_S, query=True,
                )
            )  # fmt: skip
        for reply in await bus.cycle(commands):
            assert reply.values[R.MODE] == moteus.Mode.POSITION, reply
            length[reply.id] = SCREW_M * reply.values[R.POSITION]
            rate[reply.id] = SCREW_M * reply.values[R.VELOCITY]
        await asyncio.sleep(0.005)
    print("moved by", ", ".join(f"{1e3 * (length[k] - start[k]):.1f}" for k in sorted(start)), "mm")
    await bus.cycle([drive.make_stop(query=True) for drive in drives])
    bus.close()


asyncio.run(main())
