"""Kernels as other kernels call them: kept as LLVM code, without machine code of their own.

numba makes machine code of each compiled function. What is called by a kernel is compiled into
that kernel in any case, so of a part it is never run; leaving it out halves the work of LLVM.
"""

from types import FunctionType
from typing import Any, Final

import llvmlite.binding as llvm
from numba.core import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, Flags
from numba.core.environment import lookup_environment
from numba.core.registry import CPUDispatcher

_NO_ADDRESS: Final = 0
_ENVIRONMENT: Final = "_ZN08NumbaEnv"


def renamed(function: FunctionType) -> FunctionType:
    """Return the same function under another name, as the cache goes by names."""
    copy = FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__module__ = function.__module__
    copy.__qualname__ = f"{function.__qualname__}.part"
    return copy


class _NoMachineCode:
    """Stands for the code generator where numba would write to the machine code of a part."""

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: the environment's address is written into the kernel that is run."""


class _PartLibrary(JITCodeLibrary):
    """LLVM code to be linked into that of the callers, which optimise it as a whole."""

    codegen = _NoMachineCode()

    def finalize(self) -> None:
        """Link what the part itself calls."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return no address, as for a function without a way in from Python."""
        self._ensure_finalized()
        return _NO_ADDRESS

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """Return what is kept in the cache."""
        self._ensure_finalized()
        return self.name, "part", self._get_module_for_linking().as_bitcode()

    @classmethod
    def loaded(cls, codegen: Any, state: tuple[str, str, bytes]) -> "_PartLibrary":
        """Return the library that was kept in the cache as `state`."""
        name, _, bitcode = state
        library = cls(codegen, name)
        library._final_module = library._shared_module = llvm.parse_bitcode(bitcode)
        library._finalize_dynamic_globals()
        library._finalized = True
        return library


class _Loader:
    """The target that a cached part is loaded for; it hands out libraries of parts."""

    def __init__(self, target: Any) -> None:
        self._target = target

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)

    def codegen(self) -> Any:
        """Return what reads a library from the cache."""
        return self

    def unserialize_library(self, state: tuple[str, str, bytes]) -> _PartLibrary:
        """Return the library kept as `state`."""
        return _PartLibrary.loaded(self._target.codegen(), state)


class _PartCacheImpl(CompileResultCacheImpl):
    def reduce(self, cres: Any) -> Any:
        # To write out the type of every variable takes longer than all else.
        return super().reduce(cres._replace(type_annotation=""))

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        loaded = CompileResult._rebuild(_Loader(target_context), *payload)
        return loaded._replace(target_context=target_context)


class _PartCache(FunctionCache):
    _impl_class = _PartCacheImpl


class _Flags(Flags):
    """numba's options of a function, compared by what was set.

    They are compared at every call that is compiled, and numba collects all thirty at each.
    """

    __slots__ = ()

    def __hash__(self) -> int:
        return _HASH_OF_FLAGS

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Flags):
            return NotImplemented
        said, heard = self._values, other._values
        return said == heard or all(
            getattr(self, name) == getattr(other, name) for name in said.keys() | heard.keys()
        )


_HASH_OF_FLAGS: Final = hash(Flags())


class _EntryCompiler(Compiler):
    """numba's compiler, with options that compare quickly."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*(_Flags(each) if type(each) is Flags else each for each in arguments))


class _PartCompiler(_EntryCompiler):
    """The same, writing to a library of a part."""

    def _compile_bytecode(self) -> Any:
        state = self.state
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return super()._compile_bytecode()


def _plain(kind: Any) -> Any:
    """Return the type of a number where `kind` is that of one literal number."""
    return types.unliteral(kind)


class Part(CPUDispatcher):
    """A kernel as other kernels call it.

    Compiled for the types of its arguments alone: numba would do so for each literal number again.
    """

    def __init__(self, function: FunctionType, targetoptions: dict[str, Any]) -> None:
        options = {**targetoptions, "no_cpython_wrapper": True}
        super().__init__(renamed(function), targetoptions=options, pipeline_class=_PartCompiler)

    def enable_caching(self) -> None:
        """Keep and load LLVM code."""
        self._cache = _PartCache(self.py_func)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Resolve a call out of a kernel."""
        plain = {name: _plain(kind) for name, kind in dict(kws).items()}
        return super().get_call_template(tuple(_plain(kind) for kind in args), plain)


class Entry(CPUDispatcher):
    """A kernel as Python calls it; other kernels are handed `part` in its place."""

    def __init__(self, function: FunctionType, targetoptions: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=targetoptions, pipeline_class=_EntryCompiler)
        self.part = Part(function, targetoptions)

    @property
    def _numba_type_(self) -> Any:
        return self.part._numba_type_

    def add_overload(self, result: Any) -> None:
        """Take what was compiled, and write where the values lie that its parts raise."""
        super().add_overload(result)
        for name in (each.name for each in result.library._final_module.global_variables):
            environment = lookup_environment(name) if name.startswith(_ENVIRONMENT) else None
            if environment is not None:
                result.library.codegen.set_env(name, environment)
