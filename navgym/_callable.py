"""Packages that can be called: `navgym.filters()` lists filters, `navgym.filters.bank` is a module.

Python binds a package to its name in the parent as soon as any of its modules is imported, so a
function of the same name would be replaced by it. Instead the package itself answers the call.
"""

from __future__ import annotations

from types import ModuleType


class CallableModule(ModuleType):
    """A package whose call is answered by its function `listing`."""

    def __call__(self) -> dict[str, str]:
        found: dict[str, str] = self.listing()
        return found
