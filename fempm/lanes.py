"""Four particles at a time: numbers with four lanes for compiled code, and formulas of them.

Compilers do not vectorise loops over the particles of a cell by themselves. Here a value of type `lanes` is
one vector of the processor (LLVM splits or widens it where the hardware has another width), and a
`formula` is a Python function on numbers and tuples of them that runs while Numba compiles its caller: its
operations become straight-line machine code, its loops over axes are unrolled, and an argument that is
None leaves out what would use it. The same formula serves one particle (numbers are float64) and four.
"""

import inspect

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

WIDTH = 4
# no `nnan`/`ninf`: a run that goes wrong must still be seen as such
FAST = ("contract", "arcp", "nsz", "afn")
FLOAT = ir.DoubleType()
VECTOR = ir.VectorType(FLOAT, WIDTH)
INT32, INT64 = ir.IntType(32), ir.IntType(64)
INDEX = [ir.Constant(INT32, i) for i in range(WIDTH)]


class LanesType(types.Type):
    """Type of a number with one value per lane."""

    def __init__(self):
        super().__init__("Lanes")


lanes = LanesType()


@register_model(LanesType)
class LanesModel(models.PrimitiveModel):
    """A vector of float64."""

    def __init__(self, manager, numba_type):
        super().__init__(manager, numba_type, VECTOR)


class Value:
    """A number inside a formula: one value or one per lane; without a builder only its type is known."""

    def __init__(self, builder, ir_value, wide):
        self.builder, self.ir, self.wide = builder, ir_value, wide

    def widened(self, wide):
        """The LLVM value, the same in every lane where `wide` asks for lanes and there are none."""
        if self.builder is None or self.wide or not wide:
            return self.ir
        first = self.builder.insert_element(ir.Constant(VECTOR, ir.Undefined), self.ir, INDEX[0])
        return self.builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(INT32, WIDTH), None))

    def constant(self, number):
        """A number of the same width as this one."""
        data = [number] * WIDTH if self.wide else number
        return Value(self.builder, ir.Constant(VECTOR if self.wide else FLOAT, data), self.wide)

    def operate(self, operation, other, swap=False):
        """self (operation) other, or other (operation) self."""
        if not isinstance(other, Value):
            other = self.constant(float(other))
        wide = self.wide or other.wide
        if self.builder is None:
            return Value(None, None, wide)
        pair = [self.widened(wide), other.widened(wide)]
        a, b = reversed(pair) if swap else pair
        return Value(self.builder, getattr(self.builder, operation)(a, b, flags=FAST), wide)

    def __add__(self, other):
        return self.operate("fadd", other)

    def __sub__(self, other):
        return self.operate("fsub", other)

    def __mul__(self, other):
        return self.operate("fmul", other)

    def __truediv__(self, other):
        return self.operate("fdiv", other)

    def __rsub__(self, other):
        return self.operate("fsub", other, swap=True)

    def __rtruediv__(self, other):
        return self.operate("fdiv", other, swap=True)

    def __neg__(self):
        return self.operate("fsub", -0.0, swap=True)

    __radd__, __rmul__ = __add__, __mul__


def sqrt(x):
    """Square root of a formula's number."""
    if x.builder is None:
        return x
    name = f"llvm.sqrt.v{WIDTH}f64" if x.wide else "llvm.sqrt.f64"
    kind = ir.FunctionType(x.ir.type, [x.ir.type])
    function = cgutils.get_or_insert_function(x.builder.module, kind, name)
    return Value(x.builder, x.builder.call(function, [x.ir], fastmath=FAST), x.wide)


def positive(x):
    """max(x, 0), or not a number where x is not."""
    if x.builder is None:
        return x
    zero = x.constant(0.0).ir
    below = x.builder.fcmp_ordered("<", x.ir, zero)
    return Value(x.builder, x.builder.select(below, zero, x.ir), x.wide)


def where(condition, x, y):
    """x where a formula's number `condition` is not zero, y elsewhere."""
    if x.builder is None:
        return x
    other = x.builder.fcmp_unordered("!=", condition.ir, condition.constant(0.0).ir)
    return Value(x.builder, x.builder.select(other, x.ir, y.ir), x.wide)


def zero(x):
    """0 of the width of x."""
    return x.constant(0.0)


def dot(a, b):
    """Sum of products of two tuples."""
    return sum((p * q for p, q in zip(a[1:], b[1:])), start=a[0] * b[0])


def formula(function):
    """Make a Python function on numbers and (nested) tuples callable from compiled code.

    Arguments may also be None, or arrays, which a formula can only compare with None.
    """

    def define(context, *args):
        result = numba_type(function(*[symbols(None, None, t, None) for t in args]))

        def generate(context, builder, signature, values):
            given = [symbols(context, builder, t, v) for t, v in zip(signature.args, values)]
            return assemble(context, builder, signature.return_type, function(*given))

        return result(*args), generate

    define.__name__, define.__doc__ = function.__name__, function.__doc__
    own = inspect.signature(function).parameters.values()
    context = inspect.Parameter("context", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    define.__signature__ = inspect.Signature([context, *own])
    return intrinsic(define)


def symbols(context, builder, numba_type, value):
    """A formula's argument: numbers as `Value`, in tuples as given, None, and () for anything else."""
    if isinstance(numba_type, types.BaseTuple):
        parts = [None] * len(numba_type) if builder is None else cgutils.unpack_tuple(builder, value)
        return tuple(symbols(context, builder, t, v) for t, v in zip(numba_type, parts))
    if isinstance(numba_type, types.NoneType):
        return None
    if isinstance(numba_type, types.Float | types.Integer):
        if builder is not None:
            value = context.cast(builder, value, numba_type, types.float64)
        return Value(builder, value, wide=False)
    return Value(builder, value, wide=True) if numba_type == lanes else ()


def numba_type(result):
    """The type of what a formula returns."""
    if isinstance(result, tuple):
        return types.BaseTuple.from_types([numba_type(part) for part in result])
    if result is None:
        return types.none
    return lanes if isinstance(result, Value) and result.wide else types.float64


def assemble(context, builder, numba_type, result):
    """The LLVM value of what a formula returns."""
    if isinstance(result, tuple):
        parts = [assemble(context, builder, t, r) for t, r in zip(numba_type, result)]
        return context.make_tuple(builder, numba_type, parts)
    if result is None:
        return context.get_dummy_value()
    return result.ir if isinstance(result, Value) else ir.Constant(FLOAT, float(result))
