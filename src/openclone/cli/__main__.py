"""``python -m openclone.cli`` is the command `openclone`."""

import sys

from openclone.cli import main

sys.exit(main())
