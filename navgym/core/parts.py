"""How numba compiles what only kernels call. What stands here is frozen into kernels.

Numba optimises every function it compiles, makes machine code of it and of a wrapper for Python,
and then does the same once more for each caller that it is linked into: seven times for a factor
inside an update inside a sweep inside a step inside a run. Of a part none but the last is ever run.
So a part stops at LLVM's language; all else happens once, in the kernel that it ends up in.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import LoweringPass, PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import AnnotateTypes, NativeLowering

_KERNEL: dict[str, Any] = {
    "nopython": True,
    "error_model": "numpy",
    "nogil": True,
    "boundscheck": None,
}
_PART = _KERNEL | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class _Language(JITCodeLibrary):
    """A part in LLVM's language, neither optimised nor made into machine code."""

    def _optimize_final_module(self) -> None:
        """Left to the kernel that links it."""

    def _finalize_final_module(self) -> None:
        """Left to the kernel, but for what tells it whether it may be cached."""
        self._finalize_dynamic_globals()
        self._finalized = True


class _Packed(JITCodeLibrary):
    """A kernel in whose straight lines neighbouring numbers share vector instructions."""

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager(slp_vectorize=True)
        passes.run(self._final_module, builder)


@register_pass(mutates_CFG=False, analysis_only=True)
class _Begin(LoweringPass):
    """Before it is lowered: where a part's code goes."""

    _name = "navgym_begin_part"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Set the library; tell numba that there will be nothing to call."""
        state.library = _Language(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        return False


@register_pass(mutates_CFG=False, analysis_only=True)
class _Offer(LoweringPass):
    """After it is lowered: kernels find a part by a key, where numba has the compiled function."""

    _name = "navgym_offer_part"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Make the part known to numba as a function that others may call."""
        key = object()
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.reload_init.extend(state.library._reload_init)
        state.cr = state.cr._replace(cfunc=key)
        return False


@register_pass(mutates_CFG=False, analysis_only=True)
class _Pack(LoweringPass):
    """Before it is lowered: where a packed kernel's code goes."""

    _name = "navgym_pack"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Set the library, kept for the cache as numba's own is."""
        state.library = _Packed(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class _PartCompiler(CompilerBase):
    """Numba's own, with the two passes around its lowering."""

    def define_pipelines(self) -> list[PassManager]:
        """The passes, in order."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_Begin, AnnotateTypes)
        passes.add_pass_after(_Offer, NativeLowering)
        passes.finalize()
        return [passes]


class _PackedCompiler(CompilerBase):
    """Numba's own, with another library."""

    def define_pipelines(self) -> list[PassManager]:
        """The passes, in order."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_Pack, AnnotateTypes)
        passes.finalize()
        return [passes]


class Part(CPUDispatcher):
    """A function that kernels call. From Python it can't be called: TypeError.

    Args:
        py_func: its Python form.
        locals: as numba has it.
        targetoptions: beside those that every part has.
    """

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: dict[str, Any] | None = None,  # noqa: A002 - numba's names, by which it unpickles
        targetoptions: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(py_func, locals, _PART | (targetoptions or {}), _PartCompiler)

    def add_overload(self, cres: Any) -> None:
        """Keep what was compiled for some types."""
        self.overloads[tuple(cres.signature.args)] = cres

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Parts have no machine code of their own."""
        raise TypeError(f"{self.py_func.__name__} is part of kernels: call one of those")


class Kernel(CPUDispatcher):
    """A function that Python calls. A kernel that calls it takes it in as a part.

    Args:
        py_func: its Python form.
        locals: as numba has it.
        targetoptions: beside those that every kernel has.
        packed: see `compile.packed`. An unpickled kernel is not: it gives the same digits.
    """

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: dict[str, Any] | None = None,  # noqa: A002 - numba's names, by which it unpickles
        targetoptions: dict[str, Any] | None = None,
        packed: bool = False,
    ) -> None:
        compiler = _PackedCompiler if packed else Compiler
        super().__init__(py_func, locals, _KERNEL | (targetoptions or {}), compiler)
        self._part = Part(py_func)

    def compile(self, sig: Any) -> Any:
        """Compile for some types, or load what was compiled; returns the function.

        Without the collector of garbage: there is none among the millions of objects that numba
        makes, and looking for it takes a tenth of the time.
        """
        collecting = gc.isenabled()
        gc.disable()
        try:
            return super().compile(sig)
        finally:
            if collecting:
                gc.enable()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """How a kernel calls it."""
        return self._part.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        """The key of what a kernel calls."""
        return self._part.get_overload(sig)
