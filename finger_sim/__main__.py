"""`python3 -m finger_sim` is `finger_sim`."""

import sys

from .cli import main

sys.exit(main())
