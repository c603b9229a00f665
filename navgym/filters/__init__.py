"""Filters: compiled kernels, and the catalogue that names them. Called, it lists them."""

import sys

from navgym._callable import CallableModule


def listing() -> dict[str, str]:
    """Every filter's name and one line on it: what `navgym.filters()` returns."""
    from navgym.estimation import filters

    return filters()


sys.modules[__name__].__class__ = CallableModule
