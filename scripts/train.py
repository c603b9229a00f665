"""Train a policy that sets a filter's parameters while it runs: see --help."""

from __future__ import annotations

import sys

from navgym.agents.training.command import main

if __name__ == "__main__":
    sys.exit(main())
