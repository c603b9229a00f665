"""Is a policy better than the simpler ways of choosing parameters, and where? See --help."""

from __future__ import annotations

import sys

from navgym.agents.evaluation.command import main

if __name__ == "__main__":
    sys.exit(main())
