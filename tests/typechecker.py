"""The runtime type checker that the tests put on the package: an int may stand for a float.

jaxtyping's hook also checks functions inside functions. Those are made anew, and compiled anew by the checker, at every
call of the outer one, which took three quarters of the time of some tests: they are left as they are.
"""

from __future__ import annotations

import ast

from beartype import BeartypeConf, beartype
from jaxtyping import _import_hook

check_outer = beartype(conf=BeartypeConf(is_pep484_tower=True))


class _OuterFunctions(_import_hook.JaxtypingTransformer):
    """Functions of modules and methods of their classes are checked, nothing inside a function is."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        return node if self._inside else super().visit_FunctionDef(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        return node if self._inside else super().visit_ClassDef(node)

    @property
    def _inside(self) -> bool:
        return any(isinstance(parent, ast.FunctionDef) for parent in self._parents)


_import_hook.JaxtypingTransformer = _OuterFunctions  # before the package is imported: see conftest.py
