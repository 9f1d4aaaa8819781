"""The recorder process; started by `hil.record.recording`, not by people."""

import sys

from hil.record.recorder import main

sys.exit(main(sys.argv[1:]))
