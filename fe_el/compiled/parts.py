"""How loops are compiled, and those that only other loops call.

Of every function numba makes machine code, with entries for Python and C, and once more of all that it calls in every
caller, level by level. What only other loops call needs none of that: it is read, its types are found, and it is compiled
together with its callers. Of a bed from a cold cache that saves a third of the time.
"""
import numba
from numba.core import codegen, compiler, typed_passes
from numba.core.compiler_machinery import register_pass


class _Flags(compiler.Flags):
    """Options of a function. numba compares all of them whenever it looks a function up: those that are set will do."""

    def values(self):
        return self._values


class Compiler(compiler.CompilerBase):
    """numba's stages, faster."""

    lowering = typed_passes.NativeLowering

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.state.flags = _Flags(self.state.flags)

    def define_pipelines(self):
        stages = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        stages.passes = [(self.lowering if stage is typed_passes.NativeLowering else stage, text)
                         for stage, text in stages.passes]
        stages.finalize()
        return [stages]


class _Part(codegen.JITCodeLibrary):
    """Code and what it calls, neither optimised nor made ready to run: that is done to the caller's, which holds it."""

    def _optimize_final_module(self):
        pass

    def _finalize_final_module(self):
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(typed_passes.NativeLowering):
    """To code for LLVM, for compiled callers only."""

    _name = "part_lowering"

    def run_pass(self, state):
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        # a function is known by its entry for Python, a built-in one with arguments by place and name: this one fails
        entry = f"{{{state.func_id.func_name} is compiled into loops that call it, Python cannot}}".format
        state.targetctx.insert_user_function(entry, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=entry)
        return True


class _PartCompiler(Compiler):
    """The same without machine code."""

    lowering = _PartLowering


def part(*function, **options):
    """numba's ``njit`` for a function that only compiled ones call, and which is not cached but with them; takes its
    options."""
    compiled = numba.njit(pipeline_class=_PartCompiler, no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)
    return compiled(*function) if function else compiled
