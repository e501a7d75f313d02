"""Moving numbers between arrays and formulas: tables, particles of a cell, sums over lanes.

All arrays are contiguous. An index `i` is that of a flat view of the array, not negative and not checked. In
the hot loops arrays come as bare addresses (see `borrow`): counting references would cost a tenth there.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic, models, register_model

from .lanes import FAST, FLOAT, INDEX, INT32, INT64, VECTOR, WIDTH, lanes


def leaves(numba_type):
    """The numbers in a type, in order."""
    if isinstance(numba_type, types.BaseTuple):
        return [leaf for part in numba_type for leaf in leaves(part)]
    return [] if numba_type == types.none else [numba_type]


def nested(context, builder, numba_type, numbers):
    """A tuple of the given type from an iterator of its numbers."""
    if isinstance(numba_type, types.BaseTuple):
        parts = [nested(context, builder, t, numbers) for t in numba_type]
        return context.make_tuple(builder, numba_type, parts)
    return context.get_dummy_value() if numba_type == types.none else next(numbers)


def flat(builder, numba_type, value):
    """The numbers in a value of the given type, in order."""
    if isinstance(numba_type, types.BaseTuple):
        parts = zip(numba_type, cgutils.unpack_tuple(builder, value))
        return [number for t, v in parts for number in flat(builder, t, v)]
    return [] if numba_type == types.none else [value]


class Borrowed(types.Type):
    """Type of a contiguous array of which only the address is known: it costs no reference counts."""

    def __init__(self, dtype, ndim):
        self.dtype, self.ndim = dtype, ndim
        super().__init__(f"Borrowed({dtype}, {ndim})")


@register_model(Borrowed)
class BorrowedModel(models.PrimitiveModel):
    """The address of the first element."""

    def __init__(self, manager, numba_type):
        super().__init__(manager, numba_type, manager.lookup(numba_type.dtype).get_data_type().as_pointer())


def contiguous(array_type):
    """Refuse arrays with gaps."""
    if array_type.layout != "C":
        raise TypingError(f"{array_type}: compiled code needs contiguous arrays here")


def borrowed(array_type):
    """Type of what `borrow` returns."""
    if isinstance(array_type, types.BaseTuple):
        parts = [borrowed(part) for part in array_type]
        if isinstance(array_type, types.BaseNamedTuple):
            return types.NamedTuple(parts, array_type.instance_class)
        return types.BaseTuple.from_types(parts)
    if array_type == types.none:
        return array_type
    return Borrowed(array_type.dtype, array_type.ndim)


@intrinsic
def borrow(context, arrays):
    """The addresses of arrays (or None) in a tuple; whoever borrows must know that they stay alive."""

    def convert(context, builder, array_type, value):
        if isinstance(array_type, types.BaseTuple):
            parts = zip(array_type, cgutils.unpack_tuple(builder, value))
            return context.make_tuple(
                builder, borrowed(array_type), [convert(context, builder, t, v) for t, v in parts]
            )
        if array_type == types.none:
            return context.get_dummy_value()
        contiguous(array_type)
        return context.make_array(array_type)(context, builder, value=value).data

    def generate(context, builder, signature, values):
        return convert(context, builder, arrays, values[0])

    return borrowed(arrays)(arrays), generate


@intrinsic(prefer_literal=True)
def scratch(context, size):
    """An uninitialised array of a constant number of floats that lives until its caller returns."""

    def generate(context, builder, signature, values):
        return cgutils.alloca_once(builder, FLOAT, size=ir.Constant(INT64, size.literal_value))

    return Borrowed(types.float64, 1)(size), generate


def element(context, builder, array_type, array, index):
    """Address of an element of a contiguous array, and a function to addresses at constant distance."""
    if not isinstance(array_type, Borrowed):
        contiguous(array_type)
        array = context.make_array(array_type)(context, builder, value=array).data
    base = builder.gep(array, [index])
    return lambda i: builder.gep(base, [ir.Constant(INT64, i)])


def as_vector(builder, address):
    """Address of one number as the address of a vector."""
    return builder.bitcast(address, VECTOR.as_pointer())


def nothing(context, *_):
    """LLVM code of None."""
    return context.get_dummy_value()


@intrinsic
def take(context, array, i, axes):
    """(array[i], array[i + 1], ...), as many numbers as there are axes; None where the array is None."""
    if array == types.none:
        return types.none(array, types.intp, axes), nothing
    result = types.UniTuple(types.float64, len(axes))

    def generate(context, builder, signature, values):
        at = element(context, builder, signature.args[0], values[0], values[1])
        numbers = (builder.load(at(a)) for a in range(len(axes)))
        return nested(context, builder, signature.return_type, numbers)

    return result(array, types.intp, axes), generate


@intrinsic
def take_matrix(context, array, i, axes):
    """The same for as many rows as there are axes, one after the other."""
    result = types.UniTuple(types.UniTuple(types.float64, len(axes)), len(axes))

    def generate(context, builder, signature, values):
        at = element(context, builder, signature.args[0], values[0], values[1])
        numbers = (builder.load(at(a)) for a in range(len(axes) ** 2))
        return nested(context, builder, signature.return_type, numbers)

    return result(array, types.intp, axes), generate


@intrinsic
def entry(context, array, i):
    """array[i], None where the array is None."""
    if array == types.none:
        return types.none(array, types.intp), nothing

    def generate(context, builder, signature, values):
        at = element(context, builder, signature.args[0], values[0], values[1])
        return builder.load(at(0))

    return array.dtype(array, types.intp), generate


@intrinsic
def load(context, table, i, like):
    """Number i of a table of numbers of the width of `like`, or as many from there as `like` holds."""

    def generate(context, builder, signature, values):
        kinds, wide = leaves(like), lanes in leaves(like)
        width = WIDTH if wide else 1
        index = builder.mul(values[1], ir.Constant(INT64, width))
        at = element(context, builder, signature.args[0], values[0], index)
        addresses = [at(width * j) for j in range(len(kinds))]
        if wide:
            numbers = [builder.load(as_vector(builder, a), align=8) for a in addresses]
        else:
            numbers = [builder.load(a) for a in addresses]
        return nested(context, builder, signature.return_type, iter(numbers))

    return like(table, types.intp, like), generate


@intrinsic
def store(context, table, i, value):
    """Put a number, or those of a tuple one after the other, to number i and on of a table."""

    def generate(context, builder, signature, values):
        wide = lanes in leaves(value)
        width = WIDTH if wide else 1
        index = builder.mul(values[1], ir.Constant(INT64, width))
        at = element(context, builder, signature.args[0], values[0], index)
        for j, number in enumerate(flat(builder, value, values[2])):
            if wide:
                builder.store(number, as_vector(builder, at(width * j)), align=8)
            else:
                builder.store(number, at(j))
        return context.get_dummy_value()

    return types.none(table, types.intp, value), generate


def per_particle(array, axes, rows):
    """Type of what `gather` and `scatter` move: a number, a vector or a matrix, less `rows` indices."""
    kind = lanes
    for _ in range(array.ndim - 1 - rows):
        kind = types.UniTuple(kind, len(axes))
    return kind


def particle_entries(context, builder, array_type, array, particles, row, axes):
    """For every lane a function from i to the address of entry i of that particle."""
    size = len(axes) ** (array_type.ndim - 1)
    out = []
    for p in cgutils.unpack_tuple(builder, particles):
        p = builder.sext(p, INT64) if p.type.width < 64 else p
        index = builder.mul(p, ir.Constant(INT64, size))
        if row is not None:
            offset = builder.mul(row, ir.Constant(INT64, len(axes) ** (array_type.ndim - 2)))
            index = builder.add(index, offset)
        out.append(element(context, builder, array_type, array, index))
    return out


def gather_numbers(context, builder, signature, array, particles, row, axes):
    """LLVM code of `gather` and `gather_row`."""
    kind = signature.return_type
    entries = particle_entries(context, builder, signature.args[0], array, particles, row, axes)
    numbers = []
    for j in range(len(leaves(kind))):
        vector = ir.Constant(VECTOR, ir.Undefined)
        for lane, at in enumerate(entries):
            vector = builder.insert_element(vector, builder.load(at(j)), INDEX[lane])
        numbers.append(vector)
    return nested(context, builder, kind, iter(numbers))


@intrinsic
def gather(context, array, particles, axes):
    """array[p] for the particles p (one per lane): a number, vector or matrix per particle; None for None."""
    if array == types.none:
        return types.none(array, particles, axes), nothing

    def generate(context, builder, signature, values):
        return gather_numbers(context, builder, signature, values[0], values[1], None, axes)

    return per_particle(array, axes, 0)(array, particles, axes), generate


@intrinsic
def gather_row(context, array, particles, a, axes):
    """array[p, a] for the particles p: a number or a vector per particle; None for no array."""
    if array == types.none:
        return types.none(array, particles, types.intp, axes), nothing

    def generate(context, builder, signature, values):
        return gather_numbers(context, builder, signature, values[0], values[1], values[2], axes)

    return per_particle(array, axes, 1)(array, particles, types.intp, axes), generate


def scatter_numbers(context, builder, signature, array, particles, row, value, axes):
    """LLVM code of `scatter` and `scatter_row`."""
    entries = particle_entries(context, builder, signature.args[0], array, particles, row, axes)
    for j, number in enumerate(flat(builder, signature.args[-2], value)):
        for lane, at in enumerate(entries):
            builder.store(builder.extract_element(number, INDEX[lane]), at(j))
    return context.get_dummy_value()


@intrinsic
def scatter(context, array, particles, value, axes):
    """array[p] = value for the particles p; one that is in several lanes must have the same value there."""

    def generate(context, builder, signature, values):
        return scatter_numbers(context, builder, signature, values[0], values[1], None, values[2], axes)

    return types.none(array, particles, value, axes), generate


@intrinsic
def scatter_row(context, array, particles, a, value, axes):
    """array[p, a] = value likewise; nothing is done where the array is None."""
    if array == types.none:
        return types.none(array, particles, types.intp, value, axes), nothing

    def generate(context, builder, signature, values):
        return scatter_numbers(context, builder, signature, *values[:4], axes)

    return types.none(array, particles, types.intp, value, axes), generate


@intrinsic
def occupied(context, count):
    """1.0 in the first `count` lanes and 0.0 in the others."""

    def generate(context, builder, signature, values):
        out = ir.Constant(VECTOR, [0.0] * WIDTH)
        for lane in range(WIDTH):
            used = builder.icmp_signed(">", values[0], ir.Constant(INT64, lane))
            number = builder.select(used, ir.Constant(FLOAT, 1.0), ir.Constant(FLOAT, 0.0))
            out = builder.insert_element(out, number, INDEX[lane])
        return out

    return lanes(types.intp), generate


@intrinsic
def zeros(context, axes):
    """A zero with lanes for every axis."""

    def generate(context, builder, signature, values):
        return context.make_tuple(builder, signature.return_type, [ir.Constant(VECTOR, None)] * len(axes))

    return types.UniTuple(lanes, len(axes))(axes), generate


def lane_sums(builder, vectors):
    """The sums over the lanes of four vectors, in one vector."""

    def pick(a, b, lanes):
        return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INT32, WIDTH), lanes))

    def add(a, b, first, second):
        return builder.fadd(pick(a, b, first), pick(a, b, second), flags=FAST)

    pairs = [add(a, b, (0, 4, 2, 6), (1, 5, 3, 7)) for a, b in (vectors[:2], vectors[2:])]
    return add(*pairs, (0, 1, 4, 5), (2, 3, 6, 7))


@intrinsic
def add_totals(context, array, i, value):
    """Add the sums over the lanes of a tuple's numbers to array[i], array[i + 1], ... of a flat view."""

    def generate(context, builder, signature, values):
        at = element(context, builder, signature.args[0], values[0], values[1])
        numbers = flat(builder, value, values[2])
        for j in range(0, len(numbers), WIDTH):
            group = numbers[j : j + WIDTH]
            used = len(group)
            sums = lane_sums(builder, group + [ir.Constant(VECTOR, None)] * (WIDTH - used))
            if used == WIDTH:
                to = as_vector(builder, at(j))
                builder.store(builder.fadd(builder.load(to, align=8), sums, flags=FAST), to, align=8)
            else:
                for lane in range(used):
                    number = builder.extract_element(sums, INDEX[lane])
                    number = builder.fadd(builder.load(at(j + lane)), number, flags=FAST)
                    builder.store(number, at(j + lane))
        return context.get_dummy_value()

    return types.none(array, types.intp, value), generate
