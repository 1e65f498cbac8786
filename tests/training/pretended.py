"""A CUDA device that is pretended on the CPU, so that code for one is tried where there is none.

Tensors that are put there lie in the CPU's memory, so results are those of the CPU. But an operation that takes tensors of both
devices is refused, as a GPU refuses it, and so is a look at its memory from numpy.
"""

import contextlib
from collections.abc import Iterator
from typing import Any
from unittest import mock

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

_CPU, _CUDA = torch.device("cpu"), torch.device("cuda:0")
_COPIES = ("aten::copy_", "aten::_copy_from")
_INDEXED = ("aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_", "aten::_unsafe_index")
"""Operations whose indices may lie on the CPU where the tensor does not."""


class MixedDevicesError(RuntimeError):
    """Tensors of two devices meet, or numpy looks at the memory of a GPU."""


class _Memory:
    """The memory that is said to be a GPU's; kept, so that no other tensor gets it."""

    def __init__(self) -> None:
        self._kept: dict[int, torch.UntypedStorage] = {}
        self.moving = False
        self.computing = False
        """Whether an operation on its tensors computes: what that makes for itself lies there too."""

    def put(self, found: Any) -> None:
        part: Any
        for part in _tensors(found):
            part.pretended = True  # the empty ones have no memory
            storage = part.untyped_storage()
            self._kept[storage.data_ptr()] = storage

    def holds(self, tensor: torch.Tensor) -> bool:
        while torch._C._functorch.is_functorch_wrapped_tensor(tensor):
            tensor = torch._C._functorch.get_unwrapped(tensor)
        if not tensor.numel():
            return hasattr(tensor, "pretended")
        return tensor.untyped_storage().data_ptr() in self._kept

    def copy(self, tensor: torch.Tensor, *, there: bool) -> torch.Tensor:
        self.moving = True
        moved = tensor.clone()
        self.moving = False
        if there:
            self.put(moved)
        return moved


def _tensors(found: Any) -> list[torch.Tensor]:
    return [part for part in tree_leaves(found) if isinstance(part, torch.Tensor)]


def _is_place(part: Any) -> bool:
    return isinstance(part, torch.device) or (isinstance(part, str) and part.partition(":")[0] in ("cpu", "cuda"))


class _Placement(TorchFunctionMode):
    """Answers where tensors are, puts them on the device, and takes them from there."""

    def __init__(self, memory: _Memory) -> None:
        super().__init__()
        self._memory = memory

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs, name = kwargs or {}, getattr(func, "__name__", "")
        asked = getattr(func, "__self__", None)
        if asked is torch.Tensor.device:
            return _CUDA if self._memory.holds(args[0]) else func(*args)
        if asked is torch.Tensor.is_cuda:
            return self._memory.holds(args[0])
        if name in ("numpy", "__array__") and self._memory.holds(args[0]):
            raise MixedDevicesError("numpy looks at the memory of a GPU")
        if func is torch.device:
            return func(*args, **kwargs)
        places = [torch.device(part) for part in (*args, *kwargs.values()) if _is_place(part)]
        here = [_CPU if _is_place(part) else part for part in args]
        before, self._memory.computing = self._memory.computing, any(map(self._memory.holds, _tensors((args, kwargs))))
        try:
            result = func(*here, **{key: _CPU if _is_place(part) else part for key, part in kwargs.items()})
        finally:
            self._memory.computing = before
        there = any(place.type == "cuda" for place in places)
        if name == "_parse_to":  # a module asks which device is meant
            return (_CUDA, *result[1:]) if there else result
        if name in ("to", "cpu"):
            if (name == "cpu" or places) and self._memory.holds(args[0]) != there:
                return self._memory.copy(result, there=there)
        elif there:
            self._memory.put(result)
        return result


class _Check(TorchDispatchMode):
    """Refuses operations on tensors of both devices; the results of others lie where their tensors do."""

    def __init__(self, memory: _Memory) -> None:
        super().__init__()
        self._memory = memory

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs, name = kwargs or {}, func.name().partition(".")[0]
        if self._memory.moving:
            return func(*args, **kwargs)
        given = _tensors((args, kwargs))
        held = any(map(self._memory.holds, given))
        if name in _COPIES:
            held = self._memory.holds(args[0])
        elif held:
            indices = {id(part) for part in _tensors(args[1])} if name in _INDEXED and self._memory.holds(args[0]) else set()
            others = [p for p in given if p.dim() and p.numel() and not self._memory.holds(p) and id(p) not in indices]
            if others:
                raise MixedDevicesError(f"{name}: expected all tensors on one device; {others[0].shape} is on the CPU")
        result = func(*args, **kwargs)
        if held or (not given and self._memory.computing):
            self._memory.put(result)
        return result


@contextlib.contextmanager
def pretended_cuda() -> Iterator[None]:
    """Pretend a CUDA device."""
    memory = _Memory()
    with mock.patch("torch.cuda.current_device", return_value=0), _Placement(memory), _Check(memory):
        yield
