"""The other end of the bus: plant physics, emulated drives and FMU hosting. Never imports ``hil``."""

import drivers as _  # noqa: F401 - it notes the time before more is read
