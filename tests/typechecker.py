"""The runtime type checker that the tests put on the package: an int may stand for a float.

jaxtyping's own hook checks arguments twice, before a call and with what it returns, and binds them by name for its
messages. That took up to half the time of tests that compile little. Here beartype checks arguments and result in one
call.

Of a function that a test calls more often than `EVERY` times, every `EVERY`-th call is checked from there on: some are
called 100,000 times, with the same shapes.

The hook also checks functions inside functions. Those are made anew, and compiled anew by the checker, at every call of
the outer one, which took three quarters of the time of some tests: they are left as they are.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import types
from typing import Any, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import _import_hook, jaxtyped

_CHECK = beartype(conf=BeartypeConf(is_pep484_tower=True))
_ONE_CALL = jaxtyped("context")  # in which a letter of a shape means one size
EVERY = 32
_test: list[object] = [None]  # which runs


def begin(test: object) -> None:
    """Count the calls of this test anew."""
    _test[0] = test


def check_once(what):
    """A function, or the fields of a dataclass, whose types and shapes are checked; the checker is made when needed."""
    if inspect.isclass(what):
        if dataclasses.is_dataclass(what) and getattr(what.__init__, "__globals__", None) is not globals():
            what.__init__ = check_once(what.__init__)
        return what
    if inspect.isgeneratorfunction(what):  # its body runs after the call
        return jaxtyped(what, typechecker=_CHECK)
    checker: list = []
    counted, calls = None, 0

    @functools.wraps(what)
    def call(*args, **kwargs):
        __tracebackhide__ = True
        nonlocal counted, calls
        if counted is not _test[0]:
            counted, calls = _test[0], 0
        calls += 1
        if calls > EVERY and calls % EVERY:
            return what(*args, **kwargs)
        if not checker:
            checker.append(_CHECK(_with_hints(what)))
        with _ONE_CALL:
            return checker[0](*args, **kwargs)

    return call


def _with_hints(function: types.FunctionType) -> types.FunctionType:
    """The same function; a name that only type checkers know stands for anything."""
    twin = types.FunctionType(
        function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
    twin.__kwdefaults__, twin.__module__, twin.__qualname__ = (
        function.__kwdefaults__, function.__module__, function.__qualname__
    )  # fmt: skip
    twin.__annotations__ = {name: _hint(told, function.__globals__) for name, told in function.__annotations__.items()}
    return twin


def _hint(told: Any, names: dict[str, Any]) -> Any:
    def example(value: told):  # pyright: ignore
        del value

    example.__annotations__ = {"value": told}
    try:
        return get_type_hints(example, names, include_extras=True)["value"]
    except (NameError, AttributeError):
        return Any


class _OuterFunctions(_import_hook.JaxtypingTransformer):
    """Functions of modules and methods of their classes are checked, nothing inside a function is."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        return node if self._inside else super().visit_FunctionDef(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        return node if self._inside else super().visit_ClassDef(node)

    @property
    def _inside(self) -> bool:
        return any(isinstance(parent, ast.FunctionDef) for parent in self._parents)


def _decorator(checker: _import_hook.Typechecker) -> ast.expr:
    """`check_once` itself, where jaxtyping would put `jaxtyped(typechecker=check_once)`."""
    return ast.parse(f"jaxtyping._import_hook.Typechecker.lookup['{checker.get_hash()}']", mode="eval").body


_import_hook.JaxtypingTransformer = _OuterFunctions  # before the package is imported: see conftest.py
_import_hook.Typechecker.get_ast = _decorator
