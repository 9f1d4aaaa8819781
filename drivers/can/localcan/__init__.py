"""localcan: a virtual CAN bus between the processes of one machine, with bit time and arbitration.

There is no broker and no lock: the wire is shared memory (`wire`), and every reader advances the arbitration
(`log`). A participant (`participant`) sees a frame when its last bit would end on a real wire. Time is that
of `bench_clock`, which can stand still. `interface.LocalCanBus` is the python-can interface.
"""
