"""Entry point of the recorder process, which `hil.record.recording` starts."""

import sys

from hil.record.recorder import main

sys.exit(main(sys.argv[1:]))
