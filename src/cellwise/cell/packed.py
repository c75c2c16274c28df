"""Records of floats number by number: in a row, in a lane of many, with one of them changed.

A record lies in memory as its numbers in order, nested ones in their place. Handed over from Python
as a record numba takes it apart number by number, and takes far longer than the step that uses it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Protocol, TypeVar, get_type_hints

import numpy as np
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from cellwise.typing import FloatArray

Record = TypeVar("Record")


@lru_cache(maxsize=64)
def fields_of(kind: type) -> tuple[type, ...]:
    """What the fields of a record are: float, or records."""
    hints = get_type_hints(kind)
    return tuple(hints[name] for name in kind._fields)  # type: ignore[attr-defined]


@lru_cache(maxsize=64)
def size_of(kind: type) -> int:
    """How many numbers a record holds."""
    return 1 if kind is float else sum(size_of(field) for field in fields_of(kind))


def numbers_of(record: Any) -> Iterator[float]:
    """The numbers of a record in order."""
    for value in record:
        if isinstance(value, tuple):
            yield from numbers_of(value)
        else:
            yield value


def names_of(kind: type) -> Iterator[str]:
    """What the numbers of a record are called, in order."""
    for name, field in zip(kind._fields, fields_of(kind), strict=True):  # type: ignore[attr-defined]
        if field is float:
            yield name
        else:
            yield from names_of(field)


def place_of(kind: type, path: str) -> int:
    """Which of a record's numbers a field is: ``"watch.evidence_s"``."""
    name, _, rest = path.partition(".")
    names: tuple[str, ...] = kind._fields  # type: ignore[attr-defined]
    at = names.index(name)
    before = sum(map(size_of, fields_of(kind)[:at]))
    return before + (place_of(fields_of(kind)[at], rest) if rest else 0)


def row_of(*records: Any) -> FloatArray:
    """Records one after the other in one row, shape (numbers,)."""
    return np.array([x for record in records for x in numbers_of(record)], dtype=np.float64)


def _type_of(kind: type) -> Any:
    """A record as numba types it."""
    if kind is float:
        return types.float64
    base: Any = types.BaseTuple
    return base.from_types([_type_of(field) for field in fields_of(kind)], kind)


def _places(kind: type, path: tuple[int, ...] = ()) -> Iterator[tuple[int, ...]]:
    """Where each number of a record is within records."""
    if kind is float:
        yield path
    else:
        for at, field in enumerate(fields_of(kind)):
            yield from _places(field, (*path, at))


def _record_at(typing: Any, kind: Any, row: Any, at: Any, step: Any) -> Any:
    """The record whose numbers lie ``step`` apart from one place of a row on; compiled code only.

    Of many records side by side ``step`` is how many: the numbers of one lie in its lane.
    """
    record = _type_of(kind.instance_class)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = context.get_constant_undef(record)
        place = _pointers(context, builder, signature, arguments, 1)
        for path in _places(kind.instance_class):
            value = builder.insert_value(value, builder.load(next(place)), path)
        return value

    return record(kind, row, types.intp, types.intp), build


def _put_record(typing: Any, row: Any, at: Any, step: Any, record: Any, puts: Any) -> Any:
    """A record into such a place, or none: without a branch; compiled code only."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        at = _pointers(context, builder, signature, arguments, 0)
        for path in _places(record.instance_class):
            place = next(at)
            new = builder.extract_value(arguments[3], path)
            builder.store(builder.select(arguments[4], new, builder.load(place)), place)
        return context.get_dummy_value()

    return types.none(row, types.intp, types.intp, record, types.boolean), build


def _pointers(
    context: Any, builder: Any, signature: Any, arguments: Any, row: int
) -> Iterator[Any]:
    """Pointers to the numbers of one record, in order."""
    if isinstance(signature.args[row], types.Record):
        number = context.get_value_type(types.float64).as_pointer()
        data = builder.bitcast(arguments[row], number)
    else:
        data = context.make_array(signature.args[row])(context, builder, arguments[row]).data
    at, step = arguments[row + 1], arguments[row + 2]
    while True:
        yield builder.gep(data, [at])
        at = builder.add(at, step)


def _records_in(typing: Any, kind: Any, rows: Any) -> Any:
    """The rows of an array of numbers as records of a NumPy type; compiled code only.

    What is set in one of them is set in the array.
    """
    records = types.Array(kind.dtype, 1, "A")

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        made = context.make_array(records)(context, builder)
        parts: Any = cgutils.unpack_tuple
        populate: Any = populate_array
        populate(
            made,
            data=builder.bitcast(array.data, made.data.type),
            shape=parts(builder, array.shape)[:1],
            strides=parts(builder, array.strides)[:1],
            itemsize=context.get_constant(types.intp, kind.dtype.size),
            meminfo=array.meminfo,
            parent=array.parent,
        )
        return made._getvalue()

    return records(kind, rows), build


def _changed(typing: Any, record: Any, name: Any, value: Any) -> Any:
    """A record with another value of one field, by its name."""
    at = record.fields.index(name.literal_value)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.insert_value(arguments[0], arguments[2], at)

    return record(record, name, record.types[at]), build


def replaced(record: Record, name: str, value: Any) -> Record:
    """The same without compilation, to go through a step line by line."""
    after: Record = record._replace(**{name: value})  # type: ignore[attr-defined]
    return after


class Changed(Protocol):
    """What both are to a type checker."""

    def __call__(self, record: Record, name: str, value: Any) -> Record:
        """A record with another value of one field."""
        ...


compiled: Any = intrinsic(prefer_literal=True)(_changed)
jit_is_off = config.DISABLE_JIT  # type: ignore[attr-defined]
changed: Changed = replaced if jit_is_off else compiled
# Typed by numba alone: (kind, row, at, step) -> record and (row, at, step, record, puts).
record_at: Any = intrinsic(_record_at)
put_record: Any = intrinsic(_put_record)
# (NumPy type, rows) -> array of records
records_in: Any = intrinsic(_records_in)
