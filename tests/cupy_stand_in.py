"""A stand-in for CuPy where there is no GPU: as strict as CuPy, or stricter, computing by NumPy.

Arrays of the two libraries do not mix: nothing but `array` takes NumPy's, nothing but `asnumpy` and `get` gives them,
and NumPy's functions fail on the stand-in's with the TypeError of CuPy's. Only functions are there that the kernels
need and CuPy has, with CuPy's arguments. What is allocated is counted, so that the memory of a device can run out.
"""

from __future__ import annotations

import types
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

NUMBERS = (int, float, np.integer, np.floating)


class OutOfMemoryError(MemoryError):
    """The device's memory is full."""

    __module__ = "cupy.cuda.memory"


class CUDARuntimeError(RuntimeError):
    """The driver or the device failed."""

    __module__ = "cupy_backends.cuda.api.runtime"


class Memory:
    """Bytes on the device: how many may be, are, and were at most."""

    def __init__(self, limit: float) -> None:
        self.limit, self.used, self.peak, self.frees = limit, 0, 0, 0

    def take(self, owner: NDArray[Any]) -> None:
        """Count an array until it is gone."""
        if self.used + owner.nbytes > self.limit:
            raise OutOfMemoryError(f"Out of memory allocating {owner.nbytes} bytes")
        self.used += owner.nbytes
        self.peak = max(self.peak, self.used)
        weakref.finalize(owner, self._give, owner.nbytes)

    def _give(self, count: int) -> None:
        self.used -= count

    def free_all_blocks(self) -> None:
        """What a pool does when it is told to."""
        self.frees += 1


class Array:
    """An array on the device."""

    __array_ufunc__ = None
    __hash__ = None  # pyright: ignore[reportAssignmentType] (as for CuPy's arrays)

    def __init__(self, values: NDArray[Any], memory: Memory) -> None:
        owner = values
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        self._values, self._memory, self._owner = values, memory, owner
        self.shape, self.dtype, self.size, self.ndim = values.shape, values.dtype, values.size, values.ndim

    def __array__(self, *_: Any, **__: Any) -> NDArray[Any]:
        raise TypeError("Implicit conversion to a NumPy array is not allowed. Please use `.get()`.")

    def __iter__(self) -> Any:
        raise TypeError("element by element is no work for a device")

    def __bool__(self) -> bool:
        raise TypeError("a device is not asked for single numbers")

    __float__ = __int__ = __index__ = __bool__

    def _new(self, values: NDArray[Any]) -> Array:
        """A result: a view, or a new array whose memory is counted."""
        made = Array(np.asarray(values), self._memory)
        if made._owner is not self._owner:
            self._memory.take(made._owner)
        return made

    def get(self, out: NDArray[Any]) -> None:
        """To the host, into an array that is there."""
        assert out.flags.c_contiguous
        assert out.dtype == self._values.dtype
        assert out.shape == self._values.shape
        np.copyto(out, self._values)

    def reshape(self, *shape: Any) -> Array:
        """Of another shape."""
        return self._new(self._values.reshape(*shape))

    def transpose(self, *axes: int) -> Array:
        """With its axes in another order."""
        return self._new(self._values.transpose(*axes))

    def astype(self, dtype: Any) -> Array:
        """In numbers of another type."""
        return self._new(self._values.astype(dtype))

    def __getitem__(self, at: Any) -> Array:
        return self._new(np.asarray(self._values[_place(at)]))

    def __setitem__(self, at: Any, value: Any) -> None:
        self._values[_place(at)] = _operand(value)

    def __add__(self, other: Any) -> Array:
        return self._new(self._values + _operand(other))

    def __sub__(self, other: Any) -> Array:
        return self._new(self._values - _operand(other))

    def __mul__(self, other: Any) -> Array:
        return self._new(self._values * _operand(other))

    __rmul__ = __mul__


def _operand(value: Any) -> Any:
    if isinstance(value, Array):
        return value._values  # pyright: ignore[reportPrivateUsage]
    if type(value) in NUMBERS:
        return value
    raise TypeError(f"Unsupported type {type(value)}")


def _device(value: Any) -> NDArray[Any]:
    if not isinstance(value, Array):
        raise TypeError(f"Unsupported type {type(value)}")
    return _operand(value)


def _place(at: Any) -> Any:
    """An index: CuPy would copy NumPy's arrays to the device, each time."""
    parts: tuple[Any, ...] = at if isinstance(at, tuple) else (at,)  # pyright: ignore[reportUnknownVariableType]
    for part in parts:
        if not (part is None or part is Ellipsis or isinstance(part, (slice, int, Array))):
            raise TypeError(f"Unsupported type {type(part)}")
    found = tuple(_operand(part) if isinstance(part, Array) else part for part in parts)
    return found if isinstance(at, tuple) else found[0]


def _properties(device: int) -> dict[str, Any]:
    assert device == 0
    return {"name": b"Stand-in 1", "major": 9, "minor": 0}


class StandIn(types.ModuleType):
    """The module `cupy`.

    Args:
        memory: bytes of the device.
        failure: what every work on the device raises.
        devices: how many there are.
        wrong: results are wrong.
    """

    __version__ = "14.2.0"

    def __init__(self, memory: float = float("inf"), failure: Exception | None = None, devices: int = 1,
                 wrong: bool = False) -> None:  # fmt: skip
        super().__init__("cupy")
        self.memory, self.failure, self.devices, self.wrong = Memory(memory), failure, devices, wrong
        self.cuda = types.SimpleNamespace(
            runtime=types.SimpleNamespace(
                getDeviceCount=self._count, runtimeGetVersion=lambda: 12090, memGetInfo=lambda: (2**30, 2**31),
                getDeviceProperties=_properties),
            memory=types.SimpleNamespace(OutOfMemoryError=OutOfMemoryError))  # fmt: skip

    def _count(self) -> int:
        if self.devices < 0:
            raise CUDARuntimeError("cudaErrorInsufficientDriver: CUDA driver version is insufficient")
        return self.devices

    def _made(self, values: NDArray[Any], *sources: Array) -> Array:
        if self.failure is not None:
            raise self.failure
        made = Array(values, self.memory)
        owners = [source._owner for source in sources]  # pyright: ignore[reportPrivateUsage]
        if not any(made._owner is owner for owner in owners):  # pyright: ignore[reportPrivateUsage]
            self.memory.take(made._owner)  # pyright: ignore[reportPrivateUsage]
        return made

    def array(self, values: NDArray[Any]) -> Array:
        """To the device."""
        assert isinstance(values, np.ndarray), "to the device go whole arrays"
        return self._made(np.array(values, order="C"))

    def asnumpy(self, values: Array) -> NDArray[Any]:
        """To the host."""
        return np.array(_device(values), order="C")

    def zeros(self, shape: int | tuple[int, ...], dtype: Any) -> Array:
        """Zeros."""
        return self._made(np.zeros(shape, dtype))

    def concatenate(self, parts: Sequence[Array], axis: int = 0) -> Array:
        """Side by side."""
        return self._made(np.concatenate([_device(part) for part in parts], axis=axis))

    def minimum(self, x: Array, y: Any) -> Array:
        """The smaller of each pair."""
        return self._made(np.minimum(_device(x), _operand(y)))

    def take(self, values: Array, at: Array, axis: int | None = None) -> Array:
        """Elements, or rows."""
        return self._made(np.take(_device(values), _device(at), axis=axis))

    def matmul(self, x: Array, y: Array) -> Array:
        """Matrix products of the last two axes; CuPy's for stacks of matrices alone, as two axes go another way."""
        assert x.ndim == y.ndim
        assert x.ndim > 2
        assert x.dtype == y.dtype, "CuPy would convert the smaller, whole"
        product = np.matmul(_device(x), _device(y))
        assert np.isfinite(product).all()
        return self._made(product * (1.5 if self.wrong else 1))

    def broadcast_to(self, values: Array, shape: tuple[int, ...]) -> Array:
        """A view of a larger shape."""
        return self._made(np.broadcast_to(_device(values), shape), values)

    def moveaxis(self, values: Array, source: int | list[int], destination: int | list[int]) -> Array:
        """A view with axes in other places."""
        return self._made(np.moveaxis(_device(values), source, destination), values)

    def get_default_memory_pool(self) -> Memory:
        """Blocks to use again."""
        return self.memory

    get_default_pinned_memory_pool = get_default_memory_pool


#: What of the stand-in is to be found in CuPy under the same name, with arguments of these names.
FUNCTIONS = {"array": (), "asnumpy": (), "zeros": ("shape", "dtype"), "concatenate": ("axis",), "minimum": (),
             "take": ("axis",), "matmul": (), "broadcast_to": ("shape",), "moveaxis": ("source", "destination"),
             "get_default_memory_pool": (), "get_default_pinned_memory_pool": ()}  # fmt: skip
