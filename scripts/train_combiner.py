"""Train the combiner, a network that weighs the modes of the frozen bank: see --help."""

from __future__ import annotations

import sys

from navgym.agents.combiner.command import main

if __name__ == "__main__":
    sys.exit(main())
