"""Parameters that follow from others, such as ``MU_PW / 10``: read as arithmetic, never run as a program."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calstudy.errors import InputError

OPERATIONS: Mapping[type[ast.operator], Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
}
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "log10": np.log10,
    "abs": np.abs,
    "min": np.minimum,
    "max": np.maximum,
}
DIGITS = 12
"""Significant digits of a value: what powers and logarithms give beyond differs between machines."""


@dataclass(frozen=True, slots=True)
class Expression:
    """Arithmetic of parameters: ``+ - * / **``, brackets, numbers, and ``FUNCTIONS``."""

    text: str

    def __post_init__(self) -> None:
        _require_arithmetic(self._tree())

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that it uses, in the order of their first use."""
        nodes = [node for node in ast.walk(self._tree()) if isinstance(node, ast.Name)]
        used = {node.id for node in nodes} - set(FUNCTIONS)
        return tuple(sorted(used, key=self.text.find))

    def __call__(self, values: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Its value, for values that may be arrays, which broadcast; not finite where it has none."""
        with np.errstate(all="ignore"):
            return np.asarray(_value(self._tree(), values), float)

    def at(self, values: Mapping[str, float]) -> float:
        """Its value for numbers, to ``DIGITS`` digits."""
        return rounded(float(self(values)))

    def _tree(self) -> ast.expr:
        try:
            return ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise InputError(f"{self.text!r} is no arithmetic; write it as 'MU_PW / 10'") from error


def rounded(value: float) -> float:
    """A value to ``DIGITS`` digits."""
    return float(f"{value:.{DIGITS}g}")


def _require_arithmetic(node: ast.expr) -> None:
    """InputError for anything but arithmetic."""
    match node:
        case ast.Name():
            return
        case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
            return
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            return _require_arithmetic(operand)
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in OPERATIONS:
            _require_arithmetic(left)
            return _require_arithmetic(right)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
            if len(args) != (2 if name in ("min", "max") else 1):
                raise InputError(f"{name} takes {'two numbers' if name in ('min', 'max') else 'one number'}")
            for one in args:
                _require_arithmetic(one)
            return None
    raise InputError(
        f"{ast.unparse(node)!r} is no arithmetic of parameters; {', '.join(FUNCTIONS)} are known"
    )


def _value(node: ast.expr, values: Mapping[str, ArrayLike]) -> Any:
    match node:
        case ast.Name(id=name):
            return np.asarray(values[name], float)
        case ast.Constant(value=int() | float() as number):
            return np.float64(number)
        case ast.UnaryOp(op=operator, operand=operand):
            return -_value(operand, values) if isinstance(operator, ast.USub) else _value(operand, values)
        case ast.BinOp(left=left, op=operator, right=right):
            return OPERATIONS[type(operator)](_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=args):
            return FUNCTIONS[name](*(_value(one, values) for one in args))
    raise AssertionError(ast.dump(node))  # what is not arithmetic was refused
