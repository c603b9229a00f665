"""navgym: Gymnasium environments and tuning tools for adaptive navigation filters.

Names load on first use, so `import navgym` stays quick: `simulate`, `scenarios`, `seeds`, `read`,
`estimate`, `filters`, `parameter_space`, and the data classes `Recording`, `LinearModel`,
`CoordinatedTurnModel`, `Estimate`, `Parameter`, `ParameterSpace`; for two IMUs on a deck
`DualIMURecording`, `DeckModel`, `FlexureModel`, `DeckEstimate`, `flexure_increments`, `identify`.
Importing the package registers its environments.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from navgym.problem import register_environments

__version__ = "0.1.0"

_HOME = {
    "CoordinatedTurnModel": "navgym.turn_model",
    "DeckEstimate": "navgym.deck_estimation",
    "DeckModel": "navgym.deck_model",
    "DualIMURecording": "navgym.dual_imu",
    "Estimate": "navgym.estimation",
    "FlexureModel": "navgym.flexure",
    "LinearModel": "navgym.models",
    "Parameter": "navgym.parameters",
    "ParameterSpace": "navgym.parameters",
    "Recording": "navgym.recording",
    "estimate": "navgym.estimation",
    "flexure_increments": "navgym.deck_estimation",
    "identify": "navgym.identification",
    "parameter_space": "navgym.estimation",
    "read": "navgym.readers",
    "seeds": "navgym.scenarios.seeds",
    "simulate": "navgym.simulation",
}

_PACKAGES = ("filters", "scenarios")  # callable: see navgym._callable

__all__ = [
    "CoordinatedTurnModel",
    "DeckEstimate",
    "DeckModel",
    "DualIMURecording",
    "Estimate",
    "FlexureModel",
    "LinearModel",
    "Parameter",
    "ParameterSpace",
    "Recording",
    "__version__",
    "estimate",
    "filters",
    "flexure_increments",
    "identify",
    "parameter_space",
    "read",
    "scenarios",
    "seeds",
    "simulate",
]

if TYPE_CHECKING:
    from navgym.deck_estimation import DeckEstimate, flexure_increments
    from navgym.deck_model import DeckModel
    from navgym.dual_imu import DualIMURecording
    from navgym.estimation import Estimate, estimate, filters, parameter_space
    from navgym.flexure import FlexureModel
    from navgym.identification import identify
    from navgym.models import LinearModel
    from navgym.parameters import Parameter, ParameterSpace
    from navgym.readers import read
    from navgym.recording import Recording
    from navgym.scenarios.seeds import seeds
    from navgym.simulation import scenarios, simulate
    from navgym.turn_model import CoordinatedTurnModel


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return importlib.import_module(f"navgym.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'navgym' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


register_environments()
