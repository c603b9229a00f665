"""navgym: Gymnasium environments and tuning tools for adaptive navigation filters.

Names load on first use, so `import navgym` stays quick: `simulate`, `scenarios`, `seeds`, `read`,
`estimate`, `filters`, `parameter_space`, and the data classes `Recording`, `LinearModel`,
`Estimate`, `Parameter`, `ParameterSpace`. Importing the package registers its environments.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "Estimate": "navgym.estimation",
    "LinearModel": "navgym.models",
    "Parameter": "navgym.parameters",
    "ParameterSpace": "navgym.parameters",
    "Recording": "navgym.recording",
    "estimate": "navgym.estimation",
    "filters": "navgym.estimation",
    "parameter_space": "navgym.estimation",
    "scenarios": "navgym.simulation",
    "seeds": "navgym.scenarios.seeds",
    "simulate": "navgym.simulation",
}

__all__ = [*_HOME, "__version__"]

if TYPE_CHECKING:
    from navgym.estimation import Estimate, estimate, filters, parameter_space
    from navgym.models import LinearModel
    from navgym.parameters import Parameter, ParameterSpace
    from navgym.recording import Recording
    from navgym.scenarios.seeds import seeds
    from navgym.simulation import scenarios, simulate


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'navgym' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
