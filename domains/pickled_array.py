"""The array in a pickle that somebody else wrote, read without running it.

A pickle is a program for a stack machine, and may call whatever it names. This reader follows the few instructions with
which NumPy writes an array of numbers, calls nothing, and refuses every other instruction and name.
"""

import pickletools
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

_MOST_BYTES = 2**28
_REFUSED = "holds something else than an array of numbers"
_RECONSTRUCT = ("numpy.core.multiarray _reconstruct", "numpy._core.multiarray _reconstruct")
_NDARRAY, _DTYPE = "numpy ndarray", "numpy dtype"
_NUMBER = re.compile("[iuf][1248]")
_MARK = object()


@dataclass(frozen=True)
class _Name:
    """A function or class that the pickle names; it is never looked up."""

    name: str


@dataclass
class _Dtype:
    code: str
    order: str = "="


@dataclass
class _Array:
    values: np.ndarray | None = None


@dataclass
class _Machine:
    """The stack and the memory of the program, and a method for each kind of instruction."""

    stack: list[Any] = field(default_factory=list)
    memory: dict[int, Any] = field(default_factory=dict)

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def name(self, dotted: str) -> None:
        if dotted not in (*_RECONSTRUCT, _NDARRAY, _DTYPE):
            raise ValueError(f"it names {dotted.replace(' ', '.')!r}")
        self.push(_Name(dotted))

    def name_on_stack(self, _: None) -> None:
        attribute, module = self.stack.pop(), self.stack.pop()
        self.name(f"{module} {attribute}")

    def take(self, count: int) -> Callable[[None], None]:
        """Return the instruction that makes a tuple of the topmost values."""

        def instruction(_: None) -> None:
            start = len(self.stack) - count
            self.stack[start:] = [tuple(self.stack[start:])]

        return instruction

    def take_to_mark(self, _: None) -> None:
        place = max(i for i, value in enumerate(self.stack) if value is _MARK)
        self.stack[place:] = [tuple(self.stack[place + 1 :])]

    def call(self, _: None) -> None:
        arguments, called = self.stack.pop(), self.stack.pop()
        if called.name in _RECONSTRUCT and arguments[0] == _Name(_NDARRAY):
            self.push(_Array())
        elif called.name == _DTYPE and _NUMBER.fullmatch(arguments[0]):
            self.push(_Dtype(arguments[0]))
        else:
            raise ValueError(f"it calls {called.name.replace(' ', '.')!r} for something else")

    def build(self, _: None) -> None:
        state, built = self.stack.pop(), self.stack[-1]
        if isinstance(built, _Dtype):
            built.order = state[1]
        else:
            _, shape, dtype, by_columns, data = state
            if not all(isinstance(side, int) and side >= 0 for side in shape):
                raise ValueError("the array's shape is none")
            kind = np.dtype(dtype.order.replace("|", "=") + dtype.code)
            if prod(shape) * kind.itemsize != len(data):
                raise ValueError(f"it states shape {shape} and {len(data)} bytes")
            built.values = np.frombuffer(data, kind).reshape(shape, order="F" if by_columns else "C")

    def instructions(self) -> dict[str, Callable[[Any], None]]:
        """Return what each known instruction does with its argument."""
        constants = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "MARK": _MARK, "EMPTY_TUPLE": ()}
        values = (
            "BININT",
            "BININT1",
            "BININT2",
            "SHORT_BINUNICODE",
            "BINUNICODE",
            "SHORT_BINBYTES",
            "BINBYTES",
        )
        return (
            {name: lambda _, value=value: self.push(value) for name, value in constants.items()}
            | dict.fromkeys(values, self.push)
            | {f"TUPLE{count}": self.take(count) for count in (1, 2, 3)}
            | {name: lambda _: None for name in ("PROTO", "FRAME", "STOP")}
            | {name: lambda place: self.push(self.memory[place]) for name in ("BINGET", "LONG_BINGET")}
            | {
                name: lambda place: self.memory.update({place: self.stack[-1]})
                for name in ("BINPUT", "LONG_BINPUT")
            }
            | {
                "MEMOIZE": lambda _: self.memory.update({len(self.memory): self.stack[-1]}),
                "TUPLE": self.take_to_mark,
                "GLOBAL": self.name,
                "STACK_GLOBAL": self.name_on_stack,
                "REDUCE": self.call,
                "BUILD": self.build,
            }
        )


def read_pickled_array(path: Path) -> np.ndarray:
    """Return the array of numbers that is all that a pickle holds, as float64.

    Raises
    ------
    ValueError
        If the file is no pickle, or holds anything else; nothing in it is run.
    """
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes; at most {_MOST_BYTES} are read")
    machine = _Machine()
    instructions = machine.instructions()
    try:
        for opcode, argument, _ in pickletools.genops(path.read_bytes()):
            if opcode.name not in instructions:
                raise ValueError(f"it has the instruction {opcode.name}")
            instructions[opcode.name](argument)
        (result,) = machine.stack
        return result.values.astype(float)
    except (ValueError, TypeError, AttributeError, LookupError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path} {_REFUSED}, and is not read: {str(error)[:120]}") from None
