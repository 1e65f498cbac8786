"""PyTorch without its global state: random numbers of an own generator, and threads for one computation alone."""

import contextlib
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import torch
from torch.overrides import TorchFunctionMode

_DRAWS: Final = ("kaiming_uniform_", "normal_", "uniform_")
_MAKES: Final = ("empty", "tensor", "as_tensor")
_threads_lock: Final = threading.Lock()


class InitialWeights(TorchFunctionMode):
    """Within this context, modules make weights of float32 and draw them from a seed, whatever the defaults of PyTorch are.

    They are on the CPU, and those that the seed gives with PyTorch's own generator.
    """

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._generator = torch.Generator().manual_seed(seed)

    def __torch_function__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None) -> Any:
        """Call a function of PyTorch."""
        name, given = getattr(func, "__name__", ""), dict(kwargs or {})
        if name in _DRAWS:
            given["generator"] = self._generator
        found = func(*args, **given)
        return found.float() if name in _MAKES and given.get("dtype") is None and found.is_floating_point() else found


@contextlib.contextmanager
def own_settings(threads: int) -> Iterator[None]:
    """Compute with so many threads in this thread, with gradients, and make tensors on the CPU, whatever the caller has set.

    Other threads keep their settings, also those that start within this context.
    """
    before = torch.get_num_threads()
    _set_threads(threads)
    usual = torch.get_default_device().type == "cpu"
    try:
        # The context of a device makes every call of PyTorch slower.
        with torch.inference_mode(False), torch.enable_grad(), contextlib.nullcontext() if usual else torch.device("cpu"):
            yield
    finally:
        _set_threads(before)


def _set_threads(count: int) -> None:
    # PyTorch sets the number of this thread, and the one with which others start; only a new thread can tell that one.
    with _threads_lock, ThreadPoolExecutor(1) as other:
        default = other.submit(torch.get_num_threads).result()
        torch.set_num_threads(count)
        other.submit(torch.set_num_threads, default).result()
