"""navgym: Gymnasium environments and tuning tools for adaptive navigation filters.

Names load on first use, so `import navgym` stays quick: `simulate`, `scenarios`, `seeds`, `read`,
`inspect`, `sample_log`, `write_csv`,
`geographic`, `estimate`, `smooth`, `filters`, `parameter_space`, and the data classes `Recording`,
`LinearModel`, `CoordinatedTurnModel`, `Estimate`, `Parameter`, `ParameterSpace`; for two IMUs on a deck
`DualIMURecording`, `DeckModel`, `FlexureModel`, `DeckEstimate`, `flexure_increments`, `identify`,
`LiveBank`, `LiveDeckBank`.
Importing the package registers its environments.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from navgym.core import interrupts  # noqa: F401 - first: what follows takes a moment to load
from navgym.problem import register_environments

__version__ = "0.1.0"

_HOME = {
    "CoordinatedTurnModel": "navgym.statespace.turn_model",
    "DeckEstimate": "navgym.deck.estimation",
    "DeckModel": "navgym.deck.model",
    "DualIMURecording": "navgym.deck.recording",
    "Estimate": "navgym.estimation",
    "FlexureModel": "navgym.inertial.flexure",
    "LinearModel": "navgym.statespace.models",
    "LiveBank": "navgym.auv.live_bank",
    "LiveDeckBank": "navgym.deck.live_bank",
    "Parameter": "navgym.core.parameters",
    "ParameterSpace": "navgym.core.parameters",
    "Recording": "navgym.statespace.recording",
    "estimate": "navgym.estimation",
    "filters": "navgym.estimation",
    "flexure_increments": "navgym.deck.estimation",
    "geographic": "navgym.auv.geodesy",
    "identify": "navgym.identification",
    "inspect": "navgym.inspection.inspect",
    "parameter_space": "navgym.estimation",
    "read": "navgym.readers",
    "sample_log": "navgym.samples",
    "scenarios": "navgym.simulation",
    "seeds": "navgym.core.seeds",
    "simulate": "navgym.simulation",
    "smooth": "navgym.estimation",
    "write_csv": "navgym.auv.csv_log",
}

__all__ = [
    "CoordinatedTurnModel",
    "DeckEstimate",
    "DeckModel",
    "DualIMURecording",
    "Estimate",
    "FlexureModel",
    "LinearModel",
    "LiveBank",
    "LiveDeckBank",
    "Parameter",
    "ParameterSpace",
    "Recording",
    "__version__",
    "estimate",
    "filters",
    "flexure_increments",
    "geographic",
    "identify",
    "inspect",
    "parameter_space",
    "read",
    "sample_log",
    "scenarios",
    "seeds",
    "simulate",
    "smooth",
    "write_csv",
]

if TYPE_CHECKING:
    from navgym.auv.csv_log import write_csv
    from navgym.auv.geodesy import geographic
    from navgym.auv.live_bank import LiveBank
    from navgym.core.parameters import Parameter, ParameterSpace
    from navgym.core.seeds import seeds
    from navgym.deck.estimation import DeckEstimate, flexure_increments
    from navgym.deck.live_bank import LiveDeckBank
    from navgym.deck.model import DeckModel
    from navgym.deck.recording import DualIMURecording
    from navgym.estimation import Estimate, estimate, filters, parameter_space, smooth
    from navgym.identification import identify
    from navgym.inertial.flexure import FlexureModel
    from navgym.inspection.inspect import inspect
    from navgym.readers import read
    from navgym.samples import sample_log
    from navgym.simulation import scenarios, simulate
    from navgym.statespace.models import LinearModel
    from navgym.statespace.recording import Recording
    from navgym.statespace.turn_model import CoordinatedTurnModel


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'navgym' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


register_environments()
