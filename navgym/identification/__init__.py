"""Identification of the deck's flexure from the increments of two IMUs (IDAM section 3).

`identify` turns increments of relative attitude into a `FlexureModel`; `shrink` weighs it against
what was believed before; `RVM` is sparse Bayesian regression for any use.
"""

from navgym.identification.catalogue import METHODS, identify
from navgym.identification.correlation import Correlation, correlate
from navgym.identification.rvm import RVM
from navgym.identification.shrinkage import shrink

__all__ = ["METHODS", "RVM", "Correlation", "correlate", "identify", "shrink"]
