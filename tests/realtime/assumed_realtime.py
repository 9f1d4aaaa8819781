"""`hil` on a machine whose real-time checks always pass."""

from __future__ import annotations

from hil.app.run import command
from hil.cli import main

if __name__ == "__main__":
    vars(command).update(fifo_allowed=lambda _: True, late_share=lambda *_: 0.0)
    main()
