"""Numba's compiler with less to do: kernels are scalar, and most of what they call is part of them.

An equation is compiled for the kernels that it becomes part of. Numba optimises each function with
all that it calls, and makes machine code of it, for every function on the way up; here that is done
once, in the kernel. What is kept of an equation is LLVM's bitcode.

The passes are named in numba's documentation ("Customizing the Compiler"); libraries and caches are
numba's own, and `tests/cell/test_compiled.py` says what is relied upon.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite.binding import parse_bitcode  # type: ignore[import-untyped]
from numba.core import typed_passes, untyped_passes
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager

# A kernel has no closures, no `with`, no literals to unroll, no array expressions, and nobody reads
# its annotated types.
NOT_NEEDED = (
    untyped_passes.WithLifting,
    untyped_passes.InlineClosureLikes,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables,
    untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass,
    typed_passes.InlineOverloads,
    typed_passes.NopythonRewrites,
    typed_passes.NoPythonSupportedFeatureValidation,
    typed_passes.AnnotateTypes,
    typed_passes.DumpParforDiagnostics,
)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Python's collector, which finds nothing in a compilation, rests: a sixth of the time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


class QuietCompiler(Compiler):
    """Numba's own pipeline, undisturbed."""

    def compile_extra(self, func: Any) -> Any:
        """As numba's own."""
        with undisturbed():
            return super().compile_extra(func)  # type: ignore[no-untyped-call]


class KernelCompiler(QuietCompiler):
    """Without the passes that find nothing to do in a kernel."""

    def define_pipelines(self) -> list[Any]:
        """Numba's own but those."""
        needed = PassManager("kernel")  # type: ignore[no-untyped-call]
        whole: Any = DefaultPassBuilder.define_nopython_pipeline(self.state)  # type: ignore[no-untyped-call]
        for step, why in dict(whole.passes).items():  # what numba does again finds nothing new
            if step not in NOT_NEEDED:
                needed.add_pass(step, why)  # type: ignore[no-untyped-call]
        needed.finalize()  # type: ignore[no-untyped-call]
        return [needed]


class NoEnvironment:
    """Where numba would put a function's handle on the interpreter: no kernel asks for it."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        """Nothing to put it into."""


class KernelPart(JITCodeLibrary):
    """Bitcode for the kernels that a function is part of; no machine code of its own."""

    @property
    def codegen(self) -> Any:
        """Asked for the place of the environment alone."""
        return NoEnvironment

    def add_llvm_module(self, ll_module: Any) -> None:
        """What is not inlined in any case stays a function: kernels are large enough."""
        for function in ll_module.functions:
            if not function.is_declaration and not any(
                b"alwaysinline" in attributes for attributes in function.attributes
            ):
                function.add_function_attribute("noinline")
        super().add_llvm_module(ll_module)  # type: ignore[no-untyped-call]

    def _optimize_final_module(self) -> None:
        """Left to the kernel."""

    def _finalize_final_module(self) -> None:
        """Not handed to the execution engine."""
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Null: only compiled code calls it."""
        return 0

    def serialize_using_object_code(self) -> Any:
        """There is none: its bitcode."""
        return self.serialize_using_bitcode()  # type: ignore[no-untyped-call]


class PartCompiler(KernelCompiler):
    """Into such a library."""

    def __init__(self, typing: Any, target: Any, library: Any, *others: Any) -> None:
        of_part: Any = library
        if library is None:
            of_part = KernelPart(target.codegen(), "part")  # type: ignore[no-untyped-call]
        super().__init__(typing, target, of_part, *others)  # type: ignore[no-untyped-call]


class PartCacheImpl(CompileResultCacheImpl):
    """How it is read again."""

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """As numba's own `CompileResult._rebuild`, into a library of its kind."""
        (name, _, bitcode), fndesc, environment, signature, _, _, _, on_load, envs = payload
        for function in on_load:
            function()
        library: Any = KernelPart(target_context.codegen(), name)  # type: ignore[no-untyped-call]
        library._final_module = parse_bitcode(bitcode)
        library._finalize_final_module()
        result: Any = CompileResult
        return result(
            typing_context=target_context.typing_context,
            target_context=target_context,
            entry_point=target_context.get_executable(library, fndesc, environment),
            typing_error=None,
            type_annotation=None,
            signature=signature,
            objectmode=False,
            lifted=(),
            fndesc=fndesc,
            library=library,
            call_helper=None,
            environment=environment,
            metadata=None,
            reload_init=on_load,
            referenced_envs=envs,
        )


class PartCache(FunctionCache):
    """Kept as bitcode."""

    _impl_class = PartCacheImpl
