"""Where compiled code goes: that of a stage into the kernels that call it, that of a kernel into a library of its own.

numba gives each function a library, optimises it, makes machine code of it, and does both again in each of its
callers: a step would be optimised and written as often as its calls are deep. Here a stage has only its code, as the
compiler wrote it. A kernel takes in the code of all stages below it, once each, and is optimised as a whole.

Of all that a kernel took in, no name is known outside. Else a process that runs two kernels with one stage in common
has two versions of it, each optimised for its caller, and the linker calls the one that it saw first, also from the
other kernel: last bits would go by the order of loading, and code that went with one kernel would be called by another.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder


class _Code(JITCodeLibrary):  # type: ignore[misc]
    """Of a stage: code without machine code."""

    _linking_libraries: list[Any]

    @property
    def codegen(self) -> Any:
        """What a function with machine code would be made known to."""
        return _Nowhere

    def finalize(self) -> None:
        """Its functions may be in a kernel more than once; its environment, which only objects need, in none."""
        self._raise_if_finalized()
        for function in self._final_module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        for variable in self._final_module.global_variables:
            if variable.name.startswith("_ZN08NumbaEnv"):
                variable.linkage = "internal"
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """There is none."""
        return 0

    def _get_module_for_linking(self) -> Any:
        """For a library that is not a kernel's: its copies of stages would have names outside, and go with it."""
        raise TypeError(
            f"{self.name}: a stage, which only kernels can call (compile.kernel), not what numba.njit makes"
        )


class _Nowhere:
    """No machine code: no environment to tell it."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        pass


class _Whole(JITCodeLibrary):  # type: ignore[misc]
    """Of a kernel: with all that it calls."""

    _linking_libraries: list[Any]

    def finalize(self) -> None:
        """Links, optimises, and makes machine code."""
        own = {function.name for function in self._final_module.functions if not function.is_declaration}
        _take_in(self._final_module, self._linking_libraries)
        self._linking_libraries = []
        for function in self._final_module.functions:
            if not function.is_declaration and function.name not in own:
                function.linkage = "internal"
        super().finalize()


def _take_in(module: Any, libraries: Iterable[Any]) -> None:
    """The code of libraries, and of what is below stages among them, once each."""
    waiting = dict.fromkeys(libraries)
    seen = set[Any]()
    while waiting:
        library, _ = waiting.popitem()
        seen.add(library)
        if isinstance(library, _Code):
            module.link_in(library._final_module, preserve=True)
            waiting |= dict.fromkeys(below for below in library._linking_libraries if below not in seen)
        else:
            module.link_in(library._get_module_for_linking(), preserve=True)


class _Compiler(CompilerBase):  # type: ignore[misc]
    """numba's way to compile a function, into a library of another kind."""

    kind: type[JITCodeLibrary]

    def define_pipelines(self) -> list[Any]:
        state = self.state
        state.library = self.kind(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class ForCallers(_Compiler):
    """Of stages."""

    kind = _Code


class ForItself(_Compiler):
    """Of kernels."""

    kind = _Whole
