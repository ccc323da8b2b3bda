"""Symbolic execution of the engine's functions on terms of an SMT solver, from their own source.

An assignment under a condition keeps the old value where the condition does not hold, so that a function runs once for
all its paths. `hazards` collects what could raise. A statement or expression that is not handled here raises
NotImplementedError. Two lists are taken for different objects.

Methods run on a `Record` of their class. A call of an `Outside` returns any value of a type; in a `try` it may raise,
and then all that the block assigns is unknown.

Comparisons, min, max, negation, isfinite and assignments of floats are those of IEEE 754; integers have any size.
`Exact` computes sums, products, quotients and conversions, for terms that are numbers. `Abstract` makes them unknown
functions of which it assumes only `facts`: a claim about all such functions holds for those of IEEE 754, and the solver
need not search a multiplier of 53 bits.
"""

import ast
import inspect
import math
import struct
import sys
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, partial
from itertools import count, pairwise
from types import FunctionType
from typing import get_args, get_origin, get_type_hints

import z3

FLOAT = z3.Float64()
NEAREST = z3.RNE()
ZERO = z3.FPVal(0.0, FLOAT)
_OPERATORS = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div", ast.BitAnd: "and"}
_THRESHOLDS = (1.0, 2.0**-64, 2.0**-128)


@dataclass
class Record:
    """A dataclass's instance."""

    kind: type
    values: dict[str, object]

    def __getattr__(self, name):
        try:
            return self.values[name]
        except KeyError:
            raise AttributeError(name) from None


@dataclass(frozen=True)
class Outside:
    """A callable of which nothing is known but the type of its result."""

    returns: object


@dataclass(frozen=True)
class _Method:
    record: Record
    function: FunctionType


@dataclass(frozen=True)
class _TypeOf:
    term: z3.ExprRef


@dataclass
class Row:
    """A list of numbers that keeps its length."""

    array: z3.ArrayRef
    size: z3.ArithRef


def lift(value):
    """A number as a term; None is 0 among the integers that stand for objects."""
    if isinstance(value, z3.ExprRef):
        return value
    if value is None:
        return z3.IntVal(0)
    if isinstance(value, bool):
        return z3.BoolVal(value)
    if isinstance(value, int):
        return z3.IntVal(int(value))
    if isinstance(value, float):
        return z3.FPVal(value, FLOAT)
    if isinstance(value, str):
        return z3.StringVal(value)
    raise TypeError(f"{value!r} is not a number")


def is_float(value):
    return isinstance(value, float) or z3.is_fp(value)


def unknown(hint, name):
    """Any value of a type: a number, a row, a tuple or a dataclass; an integer stands for any other object."""
    if is_dataclass(hint):
        hints = get_type_hints(hint)
        return Record(hint, {one.name: unknown(hints[one.name], f"{name}.{one.name}") for one in fields(hint)})
    if get_origin(hint) is list:
        array = z3.Array(name, z3.IntSort(), _sort(get_args(hint)[0]))
        return Row(array, z3.Int(f"{name}.size"))
    if get_origin(hint) is tuple:
        return tuple(unknown(each, f"{name}.{i}") for i, each in enumerate(get_args(hint)))
    if hasattr(hint, "_fields"):
        hints = get_type_hints(hint)
        return hint(*(unknown(hints[field], f"{name}.{field}") for field in hint._fields))
    return z3.Const(name, _sort(hint))


def _sort(hint):
    return {float: FLOAT, bool: z3.BoolSort(), str: z3.StringSort()}.get(hint, z3.IntSort())


def known(value):
    """Terms of a value that Python has computed."""
    if is_dataclass(value):
        return Record(type(value), {one.name: known(getattr(value, one.name)) for one in fields(value)})
    if isinstance(value, list):
        array = z3.K(z3.IntSort(), lift(value[0]))
        for i, item in enumerate(value):
            array = z3.Store(array, i, lift(item))
        return Row(array, z3.IntVal(len(value)))
    if isinstance(value, tuple):
        items = map(known, value)
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    return lift(value)


def copied(value):
    """The state at this moment."""
    if isinstance(value, Record):
        return Record(value.kind, {name: copied(each) for name, each in value.values.items()})
    return Row(value.array, value.size) if isinstance(value, Row) else value


def number(term):
    """A term that is a number, as Python has it."""
    term = z3.simplify(term)
    if z3.is_fp(term):
        if term.isNaN():
            return math.nan
        return struct.unpack("<d", struct.pack("<Q", z3.simplify(z3.fpToIEEEBV(term)).as_long()))[0]
    return term.as_long() if z3.is_int(term) else z3.is_true(term)


class Exact:
    """IEEE 754, for numbers."""

    facts = ()

    def binary(self, name, a, b):
        if name == "and":
            return z3.simplify(z3.BV2Int(z3.Int2BV(a, 64) & z3.Int2BV(b, 64)))
        return z3.simplify(getattr(z3, f"fp{name.capitalize()}")(NEAREST, a, b))

    def to_float(self, n):
        return z3.simplify(z3.fpToFP(NEAREST, z3.ToReal(n), FLOAT))

    def to_int(self, x):
        real = z3.fpToReal(x)
        return z3.simplify(z3.If(real >= 0, z3.ToInt(real), -z3.ToInt(-real)))

    def at_most(self, n, x, *, strictly):
        real = z3.fpToReal(x)
        inner = z3.ToReal(n) < real if strictly else z3.ToReal(n) <= real
        return z3.simplify(z3.If(z3.fpIsNaN(x), False, z3.If(z3.fpIsInf(x), z3.fpIsPositive(x), inner)))


class Abstract:
    """Unknown functions, and in `facts` the calls that return what a proof may assume of their results."""

    def __init__(self):
        self.facts = []
        self._functions = {name: z3.Function(name, FLOAT, FLOAT, FLOAT) for name in ("add", "sub", "mul", "div")}
        self._and = z3.Function("and", z3.IntSort(), z3.IntSort(), z3.IntSort())
        self._to_float = z3.Function("to_float", z3.IntSort(), FLOAT)
        self._to_int = z3.Function("to_int", FLOAT, z3.IntSort())
        self._below = {
            strictly: z3.Function(f"below{strictly}", z3.IntSort(), FLOAT, z3.BoolSort()) for strictly in (False, True)
        }

    def binary(self, name, a, b):
        if name == "and":
            return self._and(a, b)
        result = self._functions[name](a, b)
        self.facts.append(partial(facts, name, a, b, result))
        return result

    def to_float(self, n):
        result = self._to_float(n)
        self.facts.append(lambda: [z3.Implies(n >= 0, result >= ZERO), z3.Implies(n >= 1, result >= lift(1.0))])
        return result

    def to_int(self, x):
        result = self._to_int(x)
        self.facts.append(lambda: [z3.Implies(z3.And(x > lift(-1.0), finite(x)), result >= 0)])
        return result

    def at_most(self, n, x, *, strictly):
        return self._below[strictly](n, x)


def finite(x):
    return z3.Not(z3.Or(z3.fpIsNaN(x), z3.fpIsInf(x)))


def within(x, bound):
    return z3.And(lift(-bound) <= x, x <= lift(bound))


def facts(name, a, b, result):
    """What holds of IEEE 754's operations, rounded to nearest: signs and bounds, since rounding keeps the order."""
    both = z3.And(a >= ZERO, b >= ZERO)
    if name == "add":
        return [z3.Implies(both, z3.And(result >= a, result >= b))]
    if name == "sub":
        bounded = z3.Implies(z3.And(within(a, 2.0**128), within(b, 2.0**128)), within(result, 2.0**129))
        return [z3.Implies(z3.And(a >= ZERO, finite(b)), result >= -b), bounded]
    if name == "div":
        sign = z3.Implies(z3.And(a >= ZERO, finite(a), b > ZERO), result >= ZERO)
        return [sign, z3.Implies(z3.And(within(a, 2.0**64), b >= lift(2.0**-64)), within(result, 2.0**128))]
    defined = z3.Or(z3.And(finite(a), finite(b)), z3.And(a > ZERO, b > ZERO))
    found = [z3.Implies(z3.And(both, defined), result >= ZERO)]
    for constant, other in ((a, b), (b, a)):
        if z3.is_fp_value(constant) and (c := number(constant)) > 0.0:
            found += [z3.Implies(other >= lift(least), result >= lift(c * least)) for least in _THRESHOLDS]
    return found


@cache
def _functions(module_source):
    """Functions and methods by their qualified names."""
    found = {}
    for node in ast.parse(module_source).body:
        inside = node.body if isinstance(node, ast.ClassDef) else [node]
        prefix = f"{node.name}." if isinstance(node, ast.ClassDef) else ""
        found |= {f"{prefix}{each.name}": each for each in inside if isinstance(each, ast.FunctionDef)}
    return found


def _made(kind, values):
    return kind(*values) if hasattr(kind, "_fields") else kind(values)


def _is_stored_name(node):
    return isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)


class _Frame:
    """One call: its variables, and the condition under which it has not returned."""

    def __init__(self, variables, names):
        self.variables, self.names = variables, names
        self.live, self.result = z3.BoolVal(True), None


class Execution:
    """Calls functions.

    `sources` has the text of modules that differs from that on disk, `outside` the functions that are not executed,
    each with the type of its result.
    """

    def __init__(self, arithmetic, sources=(), outside=()):
        self.arithmetic = arithmetic
        self.hazards = []
        """What would raise: function, description and condition."""
        self.calls = []
        """Name, condition, result and place of the facts of each call."""
        self.definitions = []
        """What the results of calls are: a claim that is proven without them holds of any results."""
        self.raised = []
        """Whether a `try` was left by an exception, for each of them."""
        self.is_type = {}
        """Whether a term is of a type, where the source asks."""
        self._sources, self._outside = dict(sources), dict(outside)
        self._running = []
        self._tries = 0
        self._stored = []
        self._new = count()

    def call(self, function, *arguments, given=True):
        """What a function returns; what it changes, changes in its arguments."""
        module = sys.modules[function.__module__]
        text = self._sources.get(function.__module__) or inspect.getsource(module)
        tree = _functions(text)[function.__qualname__]
        if any(ast.unparse(each) != "property" for each in tree.decorator_list):
            raise NotImplementedError(f"{function.__qualname__} has a decorator")
        names = [each.arg for each in tree.args.args]
        defaults = [self._value(_Frame({}, vars(module)), each, True) for each in tree.args.defaults]
        values = [*arguments, *defaults[len(defaults) - (len(names) - len(arguments)) :]]
        frame = _Frame(dict(zip(names, values, strict=True)), vars(module))
        given = lift(given)
        self._running.append(function.__qualname__)
        first = len(self.arithmetic.facts)
        self._block(frame, tree.body, given)
        self._running.pop()
        result = self._named(frame.result)
        self.calls.append((function.__qualname__, given, result, slice(first, len(self.arithmetic.facts))))
        return result

    def _named(self, result):
        if result is None or isinstance(self.arithmetic, Exact):
            return result
        if isinstance(result, tuple):
            return _made(type(result), map(self._named, result))
        result = lift(result)
        name = self._fresh(result.sort())
        self.definitions.append(name == result)
        return name

    # statements

    def _block(self, frame, nodes, given):
        for node in nodes:
            self._statement(frame, node, z3.simplify(z3.And(given, frame.live)))

    def _statement(self, frame, node, given):
        match node:
            case ast.Pass() | ast.Expr(value=ast.Constant()):
                return
            case ast.Expr(value=ast.Call() as call):
                self._value(frame, call, given)
            case ast.Try(body=body, handlers=[handler], orelse=orelse, finalbody=[]):
                self._try(frame, node, body, handler, orelse, given)
            case ast.Assign(targets=targets, value=value):
                found = self._value(frame, value, given)
                for target in targets:
                    self._assign(frame, target, found, given)
            case ast.AugAssign(target=target, op=op, value=value):
                place = ast.parse(ast.unparse(target), mode="eval").body
                found = self._binary(op, self._value(frame, place, given), self._value(frame, value, given))
                self._assign(frame, target, found, given)
            case ast.Return(value=value):
                found = None if value is None else self._value(frame, value, given)
                frame.result = self._merged(given, found, frame.result)
                frame.live = z3.simplify(z3.And(frame.live, z3.Not(given)))
            case ast.If(test=test, body=body, orelse=orelse):
                asked = self._truth(self._value(frame, test, given))
                self._block(frame, body, z3.And(given, asked))
                self._block(frame, orelse, z3.And(given, z3.Not(asked)))
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=[end]), orelse=[]):
                self._loop(frame, name, self._value(frame, end, given), node.body, given)
            case _:
                raise NotImplementedError(ast.unparse(node))

    def _loop(self, frame, name, end, body, given):
        """Each round where their number is known; else one round, the last, after any others."""
        end = z3.simplify(lift(end))
        if z3.is_int_value(end):
            for i in range(end.as_long()):
                frame.variables[name] = lift(i)
                self._block(frame, body, given)
            return
        if any(not isinstance(each, ast.Assign) for each in body):
            raise NotImplementedError("a loop that does more than assign")
        i = frame.variables[name] = self._fresh(z3.IntSort())
        inside = z3.And(given, i >= 0, i < end)
        for each in ast.walk(ast.Module(body, [])):
            if isinstance(each, ast.Subscript) and isinstance(each.ctx, ast.Store):
                row = self._value(frame, each.value, inside)
                row.array = z3.If(given, self._fresh(row.array.sort()), row.array)
                self._stored.append((vars(row), "array"))
            elif isinstance(each, ast.Name | ast.Attribute) and isinstance(each.ctx, ast.Store):
                raise NotImplementedError("a loop that assigns more than items")
        self._block(frame, body, inside)
        del frame.variables[name]

    def _try(self, frame, node, body, handler, orelse, given):
        """The block may be left anywhere, by any Exception or by SystemExit."""
        raised, first = z3.And(given, self._fresh(z3.BoolSort())), len(self._stored)
        self.raised.append(raised)
        self._tries += 1
        self._block(frame, body, given)
        self._tries -= 1
        inside = list(ast.walk(ast.Module(body, [])))
        if any(isinstance(each, ast.Return) or _is_stored_name(each) for each in inside):
            raise NotImplementedError("a try that returns or assigns a variable")
        for holder, name in self._stored[first:]:
            before = holder[name]
            holder[name] = self._merged(raised, self._any_like(before), before)
        kinds = self._value(frame, handler.type, given)
        for kind in (Exception, SystemExit):
            if not issubclass(kind, kinds):
                self._raises(f"{kind.__name__} escapes", node, raised)
        if handler.name:
            frame.variables[handler.name] = z3.IntVal(1)
        self._block(frame, handler.body, raised)
        self._block(frame, orelse, z3.And(given, z3.Not(raised)))

    def _any_like(self, value):
        if isinstance(value, tuple):
            return _made(type(value), map(self._any_like, value))
        return self._fresh(lift(value).sort())

    def _fresh(self, sort):
        return z3.Const(f"any{next(self._new)}", sort)

    def _assign(self, frame, target, value, given):
        match target:
            case ast.Tuple(elts=targets):
                for each, part in zip(targets, value, strict=True):
                    self._assign(frame, each, part, given)
            case ast.Name(id="_"):
                pass
            case ast.Name(id=name):
                frame.variables[name] = self._merged(given, value, frame.variables.get(name))
            case ast.Attribute(value=of, attr=name):
                record = self._value(frame, of, given)
                record.values[name] = self._merged(given, value, record.values[name])
                self._stored.append((record.values, name))
            case ast.Subscript(value=of, slice=index):
                row, i = self._value(frame, of, given), self._index(frame, of, index, given)
                row.array = self._merged(given, z3.Store(row.array, i, lift(value)), row.array)
                self._stored.append((vars(row), "array"))
            case _:
                raise NotImplementedError(ast.unparse(target))

    def _merged(self, given, new, old):
        """`new` where `given` holds, else `old`; without an old one nothing reads it there."""
        if old is None or new is old or z3.is_true(given):
            return new
        if isinstance(new, tuple):
            return _made(type(new), (self._merged(given, *both) for both in zip(new, old, strict=True)))
        new, old = lift(new), lift(old)
        if new.sort() != old.sort():
            raise TypeError(f"{new.sort()} was {old.sort()}")
        return z3.simplify(z3.If(given, new, old)) if isinstance(self.arithmetic, Exact) else z3.If(given, new, old)

    def _raises(self, what, node, condition):
        self.hazards.append((self._running[-1], f"{what}: {ast.unparse(node)}", condition))

    # expressions

    def _value(self, frame, node, given):  # noqa: C901, PLR0911, PLR0912  one return for each kind
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                if name in frame.variables:
                    return frame.variables[name]
                return frame.names[name] if name in frame.names else getattr(sys.modules["builtins"], name)
            case ast.Attribute(value=of, attr=name):
                return self._attribute(self._value(frame, of, given), name, given)
            case ast.Tuple(elts=parts):
                return tuple(self._value(frame, part, given) for part in parts)
            case ast.Subscript(value=of, slice=index):
                found = self._value(frame, of, given)
                if isinstance(found, tuple):
                    return found[self._value(frame, index, given)]
                return z3.Select(found.array, self._index(frame, of, index, given))
            case ast.Call(func=function, args=arguments, keywords=[]):
                return self._call(frame, node, function, arguments, given)
            case ast.Starred(value=value):
                return self._value(frame, value, given)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return z3.Not(self._truth(self._value(frame, operand, given)))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self._value(frame, operand, given)
            case ast.BinOp(left=left, op=op, right=right):
                a, b = self._value(frame, left, given), self._value(frame, right, given)
                if isinstance(op, ast.Div):
                    self._raises("division by zero", node, z3.And(given, self._equal(b, 0)))
                return self._binary(op, a, b)
            case ast.BoolOp(op=op, values=parts):
                return self._short_circuit(frame, op, parts, given)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                asked = self._truth(self._value(frame, test, given))
                yes = self._value(frame, body, z3.And(given, asked))
                return self._merged(asked, yes, self._value(frame, orelse, z3.And(given, z3.Not(asked))))
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                parts = [self._value(frame, part, given) for part in (left, *comparators)]
                return z3.And(*(self._compared(op, *both) for op, both in zip(ops, pairwise(parts), strict=True)))
        raise NotImplementedError(ast.unparse(node))

    def _attribute(self, of, name, given):
        """A value; for a record's class also its method, or what its property returns."""
        if not isinstance(of, Record) or name in of.values:
            return getattr(of, name)
        found = getattr(of.kind, name)
        return self.call(found.fget, of, given=given) if isinstance(found, property) else _Method(of, found)

    def _short_circuit(self, frame, op, parts, given):
        ends_with = isinstance(op, ast.Or)
        found = []
        for part in parts:
            found.append(self._truth(self._value(frame, part, given)))
            given = z3.And(given, z3.Not(found[-1]) if ends_with else found[-1])
        return (z3.Or if ends_with else z3.And)(*found)

    def _truth(self, value):
        return value if z3.is_bool(value) else z3.Not(self._equal(value, 0))

    def _index(self, frame, of, index, given):
        row, i = self._value(frame, of, given), lift(self._value(frame, index, given))
        self._raises("index out of range", index, z3.And(given, z3.Or(i < 0, i >= row.size)))
        return i

    def _float(self, value):
        if is_float(value):
            return lift(value)
        return lift(float(value)) if isinstance(value, int) else self.arithmetic.to_float(value)

    def _binary(self, op, a, b):
        name = _OPERATORS[type(op)]
        if name == "and":
            return self.arithmetic.binary(name, lift(a), lift(b))
        if name == "div" or is_float(a) or is_float(b):
            return self.arithmetic.binary(name, self._float(a), self._float(b))
        return {"add": lambda: a + b, "sub": lambda: a - b, "mul": lambda: a * b}[name]()

    def _equal(self, a, b):
        return z3.fpEQ(self._float(a), self._float(b)) if is_float(a) or is_float(b) else lift(a) == lift(b)

    def _compared(self, op, a, b):
        if isinstance(op, ast.Is | ast.IsNot):
            found = self._of_type(a.term, b) if isinstance(a, _TypeOf) else lift(a) == lift(b)
            return found if isinstance(op, ast.Is) else z3.Not(found)
        if isinstance(op, ast.In):
            return z3.Or(*(self._equal(a, each) for each in b))
        if isinstance(op, ast.Eq | ast.NotEq):
            found = self._equal(a, b)
            return found if isinstance(op, ast.Eq) else z3.Not(found)
        if isinstance(op, ast.Gt | ast.GtE):
            op, a, b = (ast.Lt() if isinstance(op, ast.Gt) else ast.LtE()), b, a
        strictly = isinstance(op, ast.Lt)
        if (is_float(a) and is_float(b)) or isinstance(a, int) or isinstance(b, int):
            floats = is_float(a) or is_float(b)  # an integer of the source is a float, too
            a, b = (self._float(a), self._float(b)) if floats else (lift(a), lift(b))
        elif is_float(a):  # integers of any size are compared exactly
            return self.arithmetic.at_most(-b, -lift(a), strictly=strictly)
        elif is_float(b):
            return self.arithmetic.at_most(a, lift(b), strictly=strictly)
        return a < b if strictly else a <= b

    def _of_type(self, term, kind):
        return self.is_type.setdefault((str(term), kind), self._fresh(z3.BoolSort()))

    def _call(self, frame, node, function, arguments, given):
        called = self._value(frame, function, given)
        parts = []
        for each in arguments:
            part = self._value(frame, each, given)
            parts += part if isinstance(each, ast.Starred) else [part]
        if isinstance(called, FunctionType) and called in self._outside:
            called = Outside(self._outside[called])
        match called:
            case Outside(returns):
                if not self._tries:
                    self._raises("what is called may raise", node, given)
                return unknown(returns, f"any{next(self._new)}")
            case _Method(record, method):
                return self.call(method, record, *parts, given=given)
            case FunctionType():
                return self.call(called, *parts, given=given)
        if isinstance(called, type) and issubclass(called, tuple):
            return called(*parts)
        return self._builtin(node, called, parts, given)

    def _builtin(self, node, called, parts, given):
        if called is type:
            return _TypeOf(lift(*parts))
        if called in (min, max):
            first, second = parts
            better = self._compared(ast.Lt(), *((second, first) if called is min else (first, second)))
            return self._merged(better, second, first)
        if called is math.isfinite:
            return finite(lift(parts[0]))
        if called is abs:
            return z3.fpAbs(lift(parts[0])) if is_float(parts[0]) else z3.If(parts[0] >= 0, parts[0], -parts[0])
        if called is int:
            self._raises("int of what is not finite", node, z3.And(given, z3.Not(finite(parts[0]))))
            return self.arithmetic.to_int(parts[0])
        raise NotImplementedError(ast.unparse(node))


def refuted(claim, *assumed):
    """A model in which the claim does not hold although all `assumed` does, or None: it is proven."""
    solver = z3.Solver()
    solver.add(*assumed, z3.Not(claim))
    answer = solver.check()
    if answer == z3.unknown:
        raise TimeoutError(solver.reason_unknown())
    return solver.model() if answer == z3.sat else None


def changed(module, old, new):
    """A module's source with one piece of its text replaced."""
    text = inspect.getsource(module)
    if text.count(old) != 1:
        raise ValueError(f"{old!r} stands {text.count(old)} times in {module.__name__}")
    return {module.__name__: text.replace(old, new)}
