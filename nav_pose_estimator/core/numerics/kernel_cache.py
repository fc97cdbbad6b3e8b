"""Numba's cache on disk, loaded without what only its compiler needs.

Before it loads the first cached kernel, numba gets its compiler ready, which takes 0.1 s and 30 MB. Of every kernel it
parses the bitcode, with which a new kernel could be linked, which is half of the time of loading it. Both wait here
until something is compiled. The files are those of numba, and a loaded kernel is the same.

A file that a power cut has left incomplete would stop numba at every start; here its kernel is compiled again. A full
disk stops it, too; here the kernel is compiled in every process until there is space.

Numba does not document the functions that this replaces, so ``jit`` uses it only with versions in which they are known.
"""

import importlib
import importlib.util
import sys
import warnings
from contextlib import suppress
from functools import cache
from typing import Any

import llvmlite.binding as llvm
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys


class _Library(JITCodeLibrary):
    """Machine code of a cached kernel. Its bitcode is parsed when a new kernel is linked with it."""

    bitcode = b""

    def _get_module_for_linking(self) -> llvm.ModuleRef:
        if self._shared_module is None:
            self._shared_module = llvm.parse_bitcode(self.bitcode)
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return self._shared_module


class _Form(CompileResultCacheImpl):
    """Form of a kernel in the cache: that of numba, read in another way."""

    def rebuild(self, target_context: Any, payload: tuple) -> CompileResult:
        """Kernel made of what the cache contains."""
        (name, _, (machine_code, bitcode)), fndesc, environment, signature, *others = payload
        objectmode, lifted, annotation, reload_init, environments = others
        for begin in reload_init:
            begin()
        library = _Library(target_context.codegen(), name)
        library.bitcode = bitcode
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        library.codegen._engine._defined_symbols |= {fndesc.llvm_func_name, fndesc.llvm_cpython_wrapper_name}
        entry_point = target_context.get_executable(library, fndesc, environment)
        for other in environments:
            library.codegen.set_env(other.env_name, other)
        return CompileResult(  # type: ignore[call-arg]  # its fields are made at run time
            target_context=target_context,
            typing_context=target_context.typing_context,
            library=library,
            environment=environment,
            entry_point=entry_point,
            fndesc=fndesc,
            type_annotation=annotation,
            signature=signature,
            objectmode=objectmode,
            lifted=lifted,
            typing_error=None,
            call_helper=None,
            metadata=None,
            reload_init=reload_init,
            referenced_envs=environments,
        )


class KernelCache(FunctionCache):
    """Cache of one kernel."""

    _impl_class = _Form

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """The kernel for arguments of the types ``sig``; None if it has to be compiled."""
        _spare_scipy_linalg()
        rtsys.initialize(target_context)  # what machine code needs at run time
        try:
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except Exception:  # a damaged pickle can raise any
            try:
                self.flush()
            except OSError:
                self.disable()
            return None

    def save_overload(self, sig: Any, data: CompileResult) -> None:
        """Store a compiled kernel.

        Numba writes the index first. If the process ended there, an index of the present source would name machine code
        of an earlier one, so that is overwritten before.
        """
        file = self._cache_file
        try:
            if self._enabled:
                next_name = file._data_name(len(file._load_index()) + 1)
                file._save_data(next_name, None)  # read as: has to be compiled
            super().save_overload(sig, data)
        except OSError as error:
            _warn_once(f"compiled kernels cannot be stored, so each start compiles them again: {error.strerror}")


@cache
def _warn_once(text: str) -> None:
    """Warn, but not of every kernel: numba makes Python forget which warnings it has shown."""
    warnings.warn(text, stacklevel=3)


@cache
def _spare_scipy_linalg() -> None:
    """Let numba find its BLAS without importing all of ``scipy.linalg``, which takes 0.2 s and is not used here.

    With its versions of NumPy's functions, compiled into a cached kernel or not, numba imports
    ``scipy.linalg.cython_blas``, for which an empty parent package suffices. Both modules are removed again, so that a
    later import of ``scipy.linalg`` gets the real one.
    """
    if "scipy.linalg" in sys.modules:
        return
    with suppress(ImportError):  # without SciPy there is nothing to spare
        spec = importlib.util.find_spec("scipy.linalg")
        if spec is None:
            return
        sys.modules["scipy.linalg"] = importlib.util.module_from_spec(spec)
        try:
            importlib.import_module("numba.np.arraymath")
        finally:
            for name in ("scipy.linalg.cython_blas", "scipy.linalg"):
                sys.modules.pop(name, None)
