"""C of functions of constants and state: those that Python and numba run, for where neither of them is.

`translated` writes the functions, all that they call, and their constants as C99 with the same bits: each operation is
one of IEEE 754's, in Python's order. The rest of a C library's mathematics is not needed, as the functions call
`elementary`. What the translator does not know it refuses, with file and line. It knows

* numbers: `float` is double, `int` int64_t, `Word` uint64_t; an integer of more than 64 bits would differ,
* dataclasses, passed by address (a frozen one as const), tuples, named tuples and rows: constant tuples, and lists of
  numbers that keep their length; an index is not negative,
* assignments, if, while, for over a range or a row, calls of functions; a variable keeps its type,
* a division by zero is infinite or NaN where Python raises: who calls checks for that.
"""

from __future__ import annotations

import ast
import builtins
import ctypes
import inspect
import math
import re
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from shutil import which
from types import FunctionType, ModuleType
from typing import Any, Final, TypeGuard, get_args, get_origin, get_type_hints

from inteco_abs import elementary
from inteco_abs.errors import AbsError

CC: Final = ("cc", "-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-Wall", "-Werror")
"""The compiler's call: no two operations may become one, which would round once."""
_PRELUDE: Final = """\
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__FAST_MATH__) || FLT_EVAL_METHOD
#error "these functions need every operation rounded to double, in the order written"
#endif

static inline double min_double(double a, double b) { return b < a ? b : a; }
static inline double max_double(double a, double b) { return b > a ? b : a; }
static inline int64_t min_int64_t(int64_t a, int64_t b) { return b < a ? b : a; }
static inline int64_t max_int64_t(int64_t a, int64_t b) { return b > a ? b : a; }
static inline int64_t modulo(int64_t a, int64_t b) { return (a % b + b) % b; }
"""


@dataclass(frozen=True, slots=True)
class Type:
    """A type by its name in C."""

    c: str


@dataclass(frozen=True, slots=True)
class _Tuple(Type):
    items: tuple[Type, ...]
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Record(Type):
    kind: Any


@dataclass(frozen=True, slots=True)
class _Row(Type):
    item: Type


_FLOAT, _INT, _WORD, _BOOL, _NOTHING = map(Type, ("double", "int64_t", "uint64_t", "bool", "void"))
_SCALARS: Final = {"float": _FLOAT, "int": _INT, "Word": _WORD, "bool": _BOOL}
_IN_CTYPES: Final = {
    _FLOAT: ctypes.c_double,
    _INT: ctypes.c_int64,
    _WORD: ctypes.c_uint64,
    _BOOL: ctypes.c_bool,
}
_OPERATORS: Final[dict[type[ast.AST], str]] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%",
    ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^", ast.LShift: "<<", ast.RShift: ">>",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    ast.And: "&&", ast.Or: "||", ast.Not: "!", ast.USub: "-", ast.UAdd: "+", ast.Invert: "~",
}  # fmt: skip
_INTEGERS_ONLY: Final = (ast.Mod, ast.BitAnd, ast.BitOr, ast.BitXor, ast.LShift, ast.RShift)
_OF_FLOATS: Final[dict[object, tuple[str, Type]]] = {
    math.sqrt: ("sqrt({})", _FLOAT),
    math.copysign: ("copysign({}, {})", _FLOAT),
    math.floor: ("(int64_t)floor({})", _INT),
    math.ceil: ("(int64_t)ceil({})", _INT),
    math.isfinite: ("isfinite({})", _BOOL),
    abs: ("fabs({})", _FLOAT),
    int: ("(int64_t){}", _INT),
}
_KEYWORDS: Final = frozenset({
    "auto", "case", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto", "inline", "int",
    "long", "register", "restrict", "short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union",
    "unsigned", "void", "volatile",
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class _C:
    """An expression."""

    text: str
    type: Type
    atom: bool = True

    def __str__(self) -> str:
        return self.text if self.atom else f"({self.text})"


@dataclass(frozen=True, slots=True)
class _Function:
    name: str
    returns: Type
    changes: bool
    """Whether it changes what it gets."""


def translated(roots: Sequence[Callable[..., Any]]) -> str:
    """C of these functions, whose names are their own, and of all that they use. Raises AbsError with file and line."""
    program = _Program()
    for root in roots:
        program.roots[root, program.types_of(root)] = root.__name__
    for root, types in program.roots:
        program.function(root, types)
    return "\n".join([_PRELUDE, *program.types.values(), *program.constants.values(), *program.functions])


def compiled_c(source: str, library: Path, *options: str) -> None:
    """Compile C to a shared library. Raises AbsError where there is no C compiler, or with what it reports."""
    if which(CC[0]) is None:
        raise AbsError("no C compiler: the command cc was not found; install one (Debian: sudo apt-get install gcc)")
    command = [*CC, *options, "-x", "c", "-", "-o", str(library), "-lm"]
    done = subprocess.run(command, input=source, capture_output=True, text=True, check=False)  # noqa: S603  our own call
    if done.returncode:
        raise AbsError(f"{library.name}: {CC[0]} failed with exit code {done.returncode}:\n{done.stderr.strip()}")


@cache
def structure(kind: Any) -> type[ctypes.Structure]:
    """A dataclass's struct, for ctypes."""
    columns = [(name, structure(of.kind) if isinstance(of, _Record) else _IN_CTYPES[of]) for name, of in _fields(kind)]
    return type(kind.__name__, (ctypes.Structure,), {"_fields_": columns})


def structured(record: Any) -> ctypes.Structure:
    """A dataclass's instance as such a struct."""
    values = [getattr(record, field.name) for field in fields(record)]
    kind: Any = type(record)
    return structure(kind)(*(structured(value) if is_dataclass(value) else value for value in values))


def _fields(kind: type[Any]) -> Iterator[tuple[str, Type]]:
    hints = get_type_hints(kind)
    for field in fields(kind):
        yield field.name, _type_of(str(field.type), hints[field.name])


def _type_of(written: str, hint: Any) -> Type:
    """Of an annotation: `Word` is an int with another name."""
    return _record(hint) if is_dataclass(hint) else _SCALARS[written if written in _SCALARS else hint.__name__]


def _record(kind: Any) -> _Record:
    return _Record(f"struct {kind.__name__}", kind)


def _literal(value: float) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return f"{value:#x}ULL" if value >= 1 << 63 else f"INT64_C({value})" if value >= 1 << 31 else str(value)
    if math.isfinite(value):
        return repr(value) if value.is_integer() and abs(value) < 1e6 else re.sub(r"0+p", "p", value.hex())
    return "(double)NAN" if math.isnan(value) else "(double)INFINITY" if value > 0.0 else "-(double)INFINITY"


def initializer(value: Any) -> str:
    """A number, or a tuple or dataclass of them, as C has it where a variable begins."""
    if is_dataclass(value):
        value = [getattr(value, field.name) for field in fields(value)]
    return f"{{{', '.join(map(initializer, value))}}}" if isinstance(value, tuple | list) else _literal(value)


_Key = tuple[Any, tuple[Type, ...]]
"""A function and the types of its arguments."""


class _Program:
    """What has been translated."""

    def __init__(self) -> None:
        self.types: dict[str, str] = {}
        self.constants: dict[str, str] = {}
        self.functions: list[str] = []
        self.roots: dict[_Key, str] = {}
        """Names that others call them by."""
        self._found: dict[_Key, _Function] = {}
        self._begun: set[_Key] = set()
        self._named = Counter[str]()

    def types_of(self, root: Any) -> tuple[Type, ...]:
        """Of a root's parameters, by its annotations."""
        hints, parameters = get_type_hints(root), inspect.signature(root).parameters
        return tuple(self._annotated(parameters[name].annotation, hints[name]) for name in parameters)

    def _annotated(self, written: str, hint: Any) -> Type:
        if get_origin(hint) is list:
            return self.row(_type_of("", get_args(hint)[0]), "")
        return self.record(hint) if is_dataclass(hint) else _type_of(written, hint)

    def record(self, kind: Any) -> _Record:
        """The struct of a dataclass."""
        found = _record(kind)
        if found.c not in self.types:
            columns = [(self.record(of.kind) if isinstance(of, _Record) else of, name) for name, of in _fields(kind)]
            self.types[found.c] = _struct(found.c, [f"{of.c} {name};" for of, name in columns])
        return found

    def row(self, item: Type, const: str) -> _Row:
        """Numbers or tuples one after the other; `const` or nothing."""
        found = _Row(f"struct {const or 'row'}_{item.c.removeprefix('struct ')}", item)
        self.types.setdefault(found.c, _struct(found.c, [f"{const} {item.c} *at;".lstrip(), "int64_t size;"]))
        return found

    def tuple_of(self, items: Sequence[Type], names: Sequence[str] = ()) -> _Tuple:
        """The struct of a tuple."""
        name = "struct of_" + "_".join(item.c.removeprefix("struct ").removesuffix("_t") for item in items)
        self.types.setdefault(name, _struct(name, [f"{item.c} _{i};" for i, item in enumerate(items)]))
        return _Tuple(name, tuple(items), tuple(names))

    def value_type(self, value: Any) -> Type:
        """Type of a constant."""
        if is_dataclass(value):
            return self.record(type(value))
        if isinstance(value, tuple):
            items = [self.value_type(item) for item in value]
            row = len(items) > 1 and all(item == items[0] for item in items) and not hasattr(value, "_fields")
            if row and (len(items) > 2 or isinstance(items[0], _Tuple)):
                return self.row(items[0], "const")
            return self.tuple_of(items, getattr(value, "_fields", ()))
        if isinstance(value, int) and not isinstance(value, bool) and value >= 1 << 63:
            return _WORD
        return _SCALARS[type(value).__name__]

    def constant(self, name: str, value: Any) -> _C:
        """A module's constant; tuples and records get a place."""
        of = self.value_type(value)
        if not isinstance(of, _Row | _Record | _Tuple):
            return _C(_literal(value), of, atom=not _literal(value).startswith("-"))
        if name not in self.constants:
            if isinstance(of, _Row):
                rows = f"static const {of.item.c} {name}_at[] = {initializer(value)};\n"
                own = f"{{{name}_at, {len(value)}}}"
            else:
                rows, own = "", initializer(value)
            self.constants[name] = f"{rows}static const {of.c} {name} = {own};\n"
        return _C(f"&{name}" if isinstance(of, _Record) else name, of, atom=not isinstance(of, _Record))

    def function(self, python: Any, types: tuple[Type, ...]) -> _Function:
        """A function for such arguments, which is translated once."""
        key = (python, types)
        if key not in self._found:
            if key in self._begun:
                raise AbsError(f"{python.__module__}.{python.__name__} calls itself: cannot be translated to C")
            self._begun.add(key)
            name = self.roots.get(key) or self._name(python)
            body = _Body(self, python, types)
            self.functions.append(body.text(name, static="" if key in self.roots else "static "))
            self._found[key] = _Function(name, body.returns, body.changes)
        return self._found[key]

    def _name(self, python: FunctionType) -> str:
        name = f"{python.__module__.rpartition('.')[2]}_{python.__name__}"
        self._named[name] += 1
        return name if self._named[name] == 1 else f"{name}__of_{self._named[name]}"


def _struct(name: str, lines: Sequence[str]) -> str:
    return "\n".join([f"{name} {{", *(f"    {line}" for line in lines), "};", ""])


class _Body:
    """One function."""

    def __init__(self, program: _Program, python: FunctionType, types: tuple[Type, ...]) -> None:
        self._program, self._python = program, python
        tree = ast.parse(inspect.getsource(python)).body[0]
        ast.increment_lineno(tree, python.__code__.co_firstlineno - 1)
        if not isinstance(tree, ast.FunctionDef) or tree.args.kwonlyargs or tree.args.vararg or tree.args.kwarg:
            raise self._refused(tree, "not a plain function")
        self._tree = tree
        names = [argument.arg for argument in tree.args.args]
        if len(names) != len(types):
            raise self._refused(tree, f"called with {len(types)} arguments, takes {len(names)}")
        self._parameters = dict(zip(names, types, strict=True))
        self._variables = dict(self._parameters)
        self._top: set[ast.expr] = set()
        self.returns: Type = _NOTHING
        self.changes = False

    def text(self, name: str, static: str) -> str:
        """The definition."""
        body = self._block([node for node in self._tree.body if not _is_docstring(node)], 1)
        own = [(of, variable) for variable, of in self._variables.items() if variable not in self._parameters]
        declared = [f"    {of.c} {variable} = {{0}};" for of, variable in own]
        says = (inspect.getdoc(self._python) or "").partition("\n")[0].replace("*/", "")
        place = f"/* {self._python.__module__}.{self._python.__name__}{': ' if says else ''}{says} */"
        parameters = ", ".join(_parameter(of, variable) for variable, of in self._parameters.items()) or "void"
        return "\n".join([place, f"{static}{self.returns.c} {name}({parameters})", "{", *declared, *body, "}", ""])

    def _refused(self, node: ast.AST, what: str) -> AbsError:
        file, line = self._python.__code__.co_filename, getattr(node, "lineno", 0)
        return AbsError(f"{file}, line {line}: cannot be translated to C: {what}")

    # statements

    def _block(self, nodes: Sequence[ast.stmt], depth: int) -> list[str]:
        pad = "    " * depth
        return [pad + line for node in nodes for line in self._statement(node)]

    def _statement(self, node: ast.stmt) -> list[str]:  # noqa: PLR0911  one return for each kind
        match node:
            case ast.Return(value=value):
                return self._return(node, value)
            case ast.Assign(targets=targets, value=value):
                return [line for target in targets for line in self._assign(target, value)]
            case ast.AugAssign(target=ast.Name() | ast.Attribute() as target, op=op, value=value):
                return self._assign(target, ast.copy_location(ast.BinOp(_loaded(target), op, value), node))
            case ast.Expr(value=ast.Call() as call):
                self._top = {call}
                return [f"{self._expression(call).text};"]
            case ast.If(test=test, body=body, orelse=orelse):
                head = [f"if ({self._truth(test).text}) {{", *self._block(body, 1)]
                return [*head, *(["} else {", *self._block(orelse, 1)] if orelse else []), "}"]
            case ast.While(test=test, body=body, orelse=[]):
                return [f"while ({self._truth(test).text}) {{", *self._block(body, 1), "}"]
            case ast.For(target=ast.Name(id=name), iter=over, body=body, orelse=[]):
                return self._for(node, name, over, body)
            case ast.Break() | ast.Continue():
                return [f"{type(node).__name__.lower()};"]
        raise self._refused(node, f"the statement {ast.unparse(node).partition(chr(10))[0]}")

    def _return(self, node: ast.stmt, value: ast.expr | None) -> list[str]:
        found = _C("", _NOTHING) if value is None else self._whole(value)
        if self.returns not in {_NOTHING, found.type}:
            raise self._refused(node, f"returns {found.type.c} here, {self.returns.c} before")
        self.returns = found.type
        return [f"return {found.text};" if value is not None else "return;"]

    def _whole(self, value: ast.expr) -> _C:
        """The whole right side of a statement: only there a function may change what it gets."""
        match value:
            case ast.IfExp(body=body, orelse=orelse):
                self._top = {body, orelse}
            case ast.BinOp(left=ast.Name(), right=right):  # what `h -= f(s)` has become
                self._top = {right}
            case _:
                self._top = {value}
        return self._expression(value)

    def _assign(self, target: ast.expr, value: ast.expr) -> list[str]:
        if not isinstance(target, ast.Tuple):
            found = self._whole(value)
            return [f"{self._place(target, found.type)} = {found.text};"]
        if isinstance(value, ast.Tuple):
            if len(value.elts) != len(target.elts):
                raise self._refused(target, f"{len(value.elts)} values for {len(target.elts)} names")
            self._top = set()
            parts = [self._expression(item) for item in value.elts]
            before = [f"    const {part.type.c} _{i} = {part.text};" for i, part in enumerate(parts)]
            named = [_C(f"_{i}", part.type) for i, part in enumerate(parts)]
        else:
            found = self._whole(value)
            if not isinstance(found.type, _Tuple) or len(found.type.items) != len(target.elts):
                raise self._refused(target, f"{found.type.c} for {len(target.elts)} names")
            before = [f"    const {found.type.c} _all = {found.text};"]
            named = [_C(f"_all._{i}", of) for i, of in enumerate(found.type.items)]
        wanted = [(each, part) for each, part in zip(target.elts, named, strict=True) if not _is_ignored(each)]
        return ["{", *before, *(f"    {self._place(each, part.type)} = {part.text};" for each, part in wanted), "}"]

    def _place(self, target: ast.expr, of: Type) -> str:
        if isinstance(target, ast.Name):
            if target.id in _KEYWORDS:
                raise self._refused(target, f"{target.id} is a word of C; choose another name")
            before = self._variables.setdefault(target.id, of)
            if before != of or isinstance(of, _Record):
                raise self._refused(target, f"{target.id} becomes {of.c}, was {before.c}")
            return target.id
        self.changes, self._top = True, set()
        found = self._expression(_loaded(target))
        if found.type != of or not isinstance(target, ast.Attribute | ast.Subscript) or isinstance(of, _Record):
            raise self._refused(target, f"{ast.unparse(target)} becomes {of.c}, was {found.type.c}")
        return found.text

    def _for(self, node: ast.stmt, name: str, over: ast.expr, body: list[ast.stmt]) -> list[str]:
        i = f"_at_{node.lineno}"
        self._top = set()
        match over:
            case ast.Call(func=ast.Name(id="range"), args=[ast.expr() as stop], keywords=[]):
                end, item = self._expression(stop), _C(i, _INT)
                if end.type != _INT:
                    raise self._refused(over, f"a range of {end.type.c}")
                count = end.text
            case ast.Name():
                row = self._expression(over)
                if not isinstance(row.type, _Row):
                    raise self._refused(over, f"a loop over {row.type.c}")
                count, item = f"{row}.size", _C(f"{row}.at[{i}]", row.type.item)
            case _:
                raise self._refused(over, f"a loop over {ast.unparse(over)}")
        own = (
            [] if name == "_" else [f"    {self._place(ast.Name(name, ast.Store(), **_at(over)), item.type)} = {item};"]
        )
        head = f"for (int64_t {i} = 0, {i}_end = {count}; {i} < {i}_end; {i}++) {{"
        return [head, *own, *self._block(body, 1), "}"]

    # expressions

    def _truth(self, node: ast.expr) -> _C:
        self._top = set()
        return self._as_truth(node)

    def _as_truth(self, node: ast.expr) -> _C:
        found = self._expression(node)
        if found.type == _BOOL:
            return found
        if found.type in {_FLOAT, _INT, _WORD}:
            return _C(f"{found} != 0", _BOOL, atom=False)
        raise self._refused(node, f"{found.type.c} as a condition")

    def _expression(self, node: ast.expr) -> _C:  # noqa: PLR0911  one return for each kind
        known, value = self._constant(node)
        if known:
            return self._of_value(node, value)
        match node:
            case ast.Name(id=name) if name in self._variables:
                return _C(name, self._variables[name])
            case ast.Attribute(value=of, attr=name):
                return self._attribute(node, self._expression(of), name)
            case ast.Subscript(value=of, slice=index):
                return self._item(node, self._expression(of), index)
            case ast.Tuple(elts=parts) if not any(isinstance(part, ast.Starred) for part in parts):
                found = [self._expression(part) for part in parts]
                kind = self._program.tuple_of([part.type for part in found])
                return _C(f"({kind.c}){{{', '.join(part.text for part in found)}}}", kind)
            case ast.Call(func=function, args=arguments, keywords=[]):
                return self._call(node, function, arguments)
        return self._operation(node)

    def _operation(self, node: ast.expr) -> _C:
        match node:
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return _C(f"!{self._as_truth(operand)}", _BOOL, atom=False)
            case ast.UnaryOp(op=op, operand=operand):
                inner = self._expression(operand)
                self._require(node, inner, _INT, *(() if isinstance(op, ast.Invert) else (_FLOAT,)))
                return _C(f"{_OPERATORS[type(op)]}{inner}", inner.type, atom=False)
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(node, self._expression(left), op, self._expression(right))
            case ast.BoolOp(op=op, values=parts):
                return _C(
                    f" {_OPERATORS[type(op)]} ".join(str(self._as_truth(part)) for part in parts), _BOOL, atom=False
                )
            case ast.Compare():
                return self._compare(node)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                asked, yes, no = self._as_truth(test), self._expression(body), self._expression(orelse)
                self._require(node, no, yes.type)
                return _C(f"{asked} ? {yes} : {no}", yes.type, atom=False)
        raise self._refused(node, ast.unparse(node))

    def _require(self, node: ast.AST, found: _C, *wanted: Type) -> None:
        if found.type not in wanted:
            raise self._refused(
                node, f"{ast.unparse(node)}: {found.type.c}, must be {' or '.join(of.c for of in wanted)}"
            )

    def _constant(self, node: ast.expr) -> tuple[bool, Any]:
        """Whether a value is known now, and the value; Python computes it, as it does when it runs."""
        match node:
            case ast.Constant(value=value):
                return True, value
            case ast.Name(id=name) if name not in self._variables and name in self._python.__globals__:
                value = self._python.__globals__[name]
                return not callable(value) and not isinstance(value, ModuleType), value
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if self._is_module(name, math):
                value = getattr(math, attribute)
                return isinstance(value, float), value
            case ast.BinOp(left=left, right=right):
                known = self._constant(left)[0] and self._constant(right)[0]
            case ast.UnaryOp(operand=operand):
                known = self._constant(operand)[0]
            case _:
                known = False
        if not known:
            return False, None
        code = compile(ast.fix_missing_locations(ast.Expression(node)), "<constant>", "eval")
        return True, eval(code, self._python.__globals__)  # noqa: S307  our own source

    def _is_module(self, name: str, module: ModuleType) -> bool:
        return name not in self._variables and self._python.__globals__.get(name) is module

    def _of_value(self, node: ast.expr, value: Any) -> _C:
        name = f"{self._python.__module__.rpartition('.')[2]}_{ast.unparse(node)}"
        try:
            return self._program.constant(name, value)
        except KeyError as error:
            raise self._refused(node, f"{ast.unparse(node)}, {error}") from None

    def _attribute(self, node: ast.expr, of: _C, name: str) -> _C:
        if isinstance(of.type, _Tuple) and name in of.type.names:
            i = of.type.names.index(name)
            return _C(f"{of}._{i}", of.type.items[i])
        if isinstance(of.type, _Record):
            found = dict(_fields(of.type.kind)).get(name)
            if isinstance(found, _Record):
                return _C(f"&{of}->{name}", self._program.record(found.kind), atom=False)
            if found is not None:
                return _C(f"{of}->{name}", found)
        raise self._refused(node, f"{ast.unparse(node)}: {of.type.c} has no such field")

    def _item(self, node: ast.expr, of: _C, index: ast.expr) -> _C:
        known, at = self._constant(index)
        if isinstance(of.type, _Tuple) and known and at in range(len(of.type.items)):
            return _C(f"{of}._{at}", of.type.items[at])
        place = self._expression(index)
        if isinstance(of.type, _Row) and place.type in {_INT, _WORD} and not (known and at < 0):
            return _C(f"{of}.at[{place.text}]", of.type.item)
        raise self._refused(node, f"{ast.unparse(node)}: an index of {of.type.c}")

    def _binary(self, node: ast.expr, left: _C, op: ast.operator, right: _C) -> _C:
        numbers = (_INT, _WORD) if isinstance(op, _INTEGERS_ONLY) else (_FLOAT, _INT, _WORD)
        self._require(node, left, *numbers)
        self._require(node, right, *numbers)
        of = next(each for each in (_FLOAT, _WORD, _INT) if each in {left.type, right.type})
        if isinstance(op, ast.Div):
            return _C(
                " / ".join(str(x) if x.type == _FLOAT else f"(double){x}" for x in (left, right)), _FLOAT, atom=False
            )
        if isinstance(op, ast.Mod):
            self._require(node, right, _INT)
            self._require(node, left, _INT)
            return _C(f"modulo({left.text}, {right.text})", _INT)
        if type(op) not in _OPERATORS:
            raise self._refused(node, f"{ast.unparse(node)}: this operator")
        return _C(f"{left} {_OPERATORS[type(op)]} {right}", of, atom=False)

    def _compare(self, node: ast.Compare) -> _C:
        operands = [node.left, *node.comparators]
        if any(isinstance(middle, ast.Call) for middle in operands[1:-1]):
            raise self._refused(node, "a call between two comparisons, which C would make twice")
        parts = [self._expression(operand) for operand in operands]
        for left, right in pairwise(parts):
            if left.type != right.type:
                self._require(node, left, _FLOAT, _INT)
                self._require(node, right, _FLOAT, _INT)
        if any(type(op) not in _OPERATORS for op in node.ops):
            raise self._refused(node, ast.unparse(node))
        each = [
            _C(f"{left} {_OPERATORS[type(op)]} {right}", _BOOL, atom=False)
            for (left, right), op in zip(pairwise(parts), node.ops, strict=True)
        ]
        return each[0] if len(each) == 1 else _C(" && ".join(map(str, each)), _BOOL, atom=False)

    def _call(self, node: ast.Call, function: ast.expr, arguments: list[ast.expr]) -> _C:
        changing = node in self._top
        self._top -= {node}
        parts = [self._expression(argument) for argument in arguments]
        called = self._called(function)
        if called in {min, max} and len(parts) > 1:
            self._require(node, parts[0], _FLOAT, _INT)
            found = parts[0]
            for part in parts[1:]:
                self._require(node, part, found.type)
                found = _C(f"{called.__name__}_{found.type.c}({found.text}, {part.text})", found.type)
            return found
        if called is len and len(parts) == 1 and isinstance(parts[0].type, _Row):
            return _C(f"{parts[0]}.size", _INT)
        if called in _OF_FLOATS:
            text, of = _OF_FLOATS[called]
            for part in parts:
                self._require(node, part, _FLOAT)
            return _C(text.format(*parts), of)
        if called is math.ldexp:
            self._require(node, parts[1], _INT)
            return _C(f"ldexp({parts[0].text}, (int){parts[1]})", _FLOAT)
        if called is math.frexp:
            return self._frexp(node, parts)
        if _is_function(called):
            return self._own_call(node, called, parts, changing=changing)
        raise self._refused(node, ast.unparse(node))

    def _called(self, function: ast.expr) -> Any:
        match function:
            case ast.Name(id=name) if name not in self._variables:
                found = self._python.__globals__.get(name)
                return getattr(builtins, name, None) if found is None else found
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if self._is_module(name, math):
                return getattr(math, attribute)
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if self._is_module(name, elementary):
                return elementary.ARITHMETICS[elementary.PORTABLE].get(attribute)
        return None

    def _frexp(self, node: ast.Call, parts: list[_C]) -> _C:
        self._require(node, parts[0], _FLOAT)
        pair = self._program.tuple_of([_FLOAT, _INT])
        text = f"static inline {pair.c} frexp_both(double x)\n{{\n    int n = 0;\n    const double m = frexp(x, &n);\n"
        self._program.constants.setdefault("frexp_both", f"{text}    return ({pair.c}){{m, n}};\n}}\n")
        return _C(f"frexp_both({parts[0].text})", pair)

    def _own_call(self, node: ast.Call, called: FunctionType, parts: list[_C], *, changing: bool) -> _C:
        found = self._program.function(called, tuple(part.type for part in parts))
        if found.changes:
            self.changes = True
            if not changing:
                raise self._refused(node, f"{ast.unparse(node)} changes what it gets: make it a statement of its own")
        return _C(f"{found.name}({', '.join(part.text for part in parts)})", found.returns)


def _parameter(of: Type, name: str) -> str:
    if isinstance(of, _Record):
        return f"{'const ' if of.kind.__dataclass_params__.frozen else ''}{of.c} *{name}"
    return f"{of.c} {name}"


def _is_function(value: object) -> TypeGuard[FunctionType]:
    return isinstance(value, FunctionType)


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _is_ignored(target: ast.expr) -> bool:
    return isinstance(target, ast.Name) and target.id == "_"


def _loaded(target: ast.expr) -> ast.expr:
    """A place that is assigned to, as an expression."""
    found = ast.parse(ast.unparse(target), mode="eval").body
    for part in ast.walk(found):
        if isinstance(part, ast.expr):
            part.lineno, part.col_offset = target.lineno, target.col_offset
    return found


def _at(node: ast.expr) -> dict[str, int]:
    return {"lineno": node.lineno, "col_offset": node.col_offset}
