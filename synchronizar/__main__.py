"""`python -m synchronizar` is the command `synchronizar`."""

import sys

from synchronizar.cli import main

sys.exit(main())
