"""Runs in the copy: share of its command that each drive applies under the new fault, as one line of JSON."""

import json

from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load
from hil.app.sim.build import build_lockstep
from hil.loop.run_end import Course
from plant_fmu.faults import FAULTS
from plant_fmu.faults.plan import FaultPlan

c = load("virtual")
cycle = build_cycle(c, 1000.0, 0.01)
nodes, plant = build_nodes(c, FaultPlan([FAULTS["derated"].model_validate({"kind": "derated", "leg": 5})]))
lockstep, course = build_lockstep(c, cycle, nodes), Course(cycle)
while cycle.mode is not Mode.RELEASING:
    lockstep.step(course.commands(lockstep.tick + 1))
seen = nodes.snapshot()
print(json.dumps((seen.force / seen.command).round(9).tolist()))
plant.close()
