"""A second device that needs no accelerator: torch and Warp compute on the CPU, but keep to CUDA's rules about devices.

Tensors on it report the device `meta`. As on CUDA, an operation that mixes them with tensors of the CPU fails (0-d tensors
and indices excepted), so does `numpy()`, and a generator draws only for its own device. Beyond CUDA's rules, our own code
may make no tensor and no Warp array without saying where.
"""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
import warp as wp
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map
from typing_extensions import Self

SECOND = "meta"
SOURCE = str(Path(__file__).parents[2] / "src") + "/"
FROM_DATA = (torch.tensor, torch.as_tensor)
MAKERS = (*FROM_DATA, torch.arange, torch.empty, torch.eye, torch.full, torch.linspace, torch.ones, torch.rand)
MAKERS += (torch.randint, torch.randn, torch.randperm, torch.scalar_tensor, torch.zeros)
INDEXING = (torch.Tensor.__getitem__, torch.Tensor.__setitem__)
COPIES = ("copy_.default", "_to_copy.default")


class OnSecond(torch.Tensor):
    """A tensor on the second device; `held` has its values."""

    held: torch.Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, held: torch.Tensor) -> Self:
        shape = held.shape, held.stride(), held.storage_offset()
        made = torch.Tensor._make_wrapper_subclass(cls, *shape, dtype=held.dtype, device=SECOND)
        made.held = held
        return made

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return compute(func, args, kwargs or {})


def compute(func: Any, args: Any, kwargs: Any) -> Any:
    """Run one operation of torch by the rules of two devices."""
    name, target, generator = str(func).removeprefix("aten."), kwargs.get("device"), kwargs.get("generator")
    given = [each for each in tree_flatten((args, kwargs))[0] if isinstance(each, torch.Tensor)]
    here = any(isinstance(each, OnSecond) for each in given)
    there = here if target is None else torch.device(target).type == SECOND
    if there and generator is not None:
        raise AssertionError(f"{name} on {SECOND} by a generator of {generator.device}")
    if here and name not in COPIES:
        indices = tree_flatten(args[1])[0] if "index" in name and isinstance(args[1], list | tuple) else []
        apart = [each for each in given if not isinstance(each, OnSecond) and each.ndim]
        if any(all(each is not index for index in indices) for each in apart):
            raise AssertionError(f"{name} of tensors on two devices: {[(each.device, each.shape) for each in given]}")
    plain_args, plain_kwargs = tree_map(lambda each: each.held if isinstance(each, OnSecond) else each, (args, kwargs))
    if target is not None:
        plain_kwargs = {**plain_kwargs, "device": torch.device("cpu")}
    result = func(*plain_args, **plain_kwargs)
    if func._schema.is_mutable:
        written = [each.alias_info is not None and each.alias_info.is_write for each in func._schema.arguments]
        named = zip(func._schema.arguments, written, strict=True)
        changed = [kwargs[a.name] if a.name in kwargs else args[i] for i, (a, own) in enumerate(named) if own]
        return changed[0] if len(changed) == 1 else tuple(changed)
    if name == "_local_scalar_dense.default" or not there:
        return result
    return tree_map(lambda each: OnSecond(each) if isinstance(each, torch.Tensor) else each, result)


class Dispatch(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return compute(func, args, kwargs or {})


class Rules:
    """What is made by our own code without a device; raised at once, or collected in `found` if that is given."""

    def __init__(self, found: list[str] | None) -> None:
        self.found = found
        self.trees: dict[int, bool] = {}

    def check(self, what: str, device: object) -> None:
        if device is None and (place := _our_line()):
            self.lost(f"{place}: {what} without a device")

    def lost(self, message: str) -> None:
        if self.found is None:
            raise AssertionError(message)
        if message not in self.found:
            self.found.append(message)

    def on_second(self, value: Any) -> Iterator[bool]:
        """Where the arrays of one argument of a kernel lie."""
        if isinstance(value, wp._src.types.array):
            if value.size:
                yield getattr(value, "second", False)
        elif isinstance(value, wp._src.codegen.StructInstance):
            for name in value._cls.vars:
                yield from self.on_second(getattr(value, name))
        elif isinstance(value, int | wp.uint64) and int(value) in self.trees:
            yield self.trees[int(value)]


class Makers(TorchFunctionMode):
    def __init__(self, rules: Rules) -> None:
        super().__init__()
        self.rules = rules

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if func in MAKERS and not (func is torch.as_tensor and isinstance(args[0], torch.Tensor)):
            self.rules.check(f"torch.{func.__name__}", kwargs.get("device"))
        if func in FROM_DATA and kwargs.get("device") is not None and torch.device(kwargs["device"]).type == SECOND:
            return func(*args, **{**kwargs, "device": "cpu"}).to(SECOND)  # torch gives `meta` no values
        if func is torch.Tensor.tolist and isinstance(args[0], OnSecond):
            return args[0].held.tolist()  # torch refuses it to subclasses
        if func is torch.Tensor.numpy and isinstance(args[0], OnSecond) and kwargs.get("force"):
            return args[0].held.detach().numpy().copy()
        if func in INDEXING and isinstance(args[0], OnSecond):
            args = args[0], tree_map(_as_index, args[1], is_leaf=lambda each: isinstance(each, list)), *args[2:]
        return func(*args, **kwargs)


def _as_index(index: Any) -> Any:
    """Lists and arrays become tensors of the CPU: torch would make them on `meta`, without values."""
    return torch.tensor(index, device="cpu") if isinstance(index, list | np.ndarray) else index


def _our_line() -> str | None:
    """The line of our own code that the caller was called from; None where it was not ours."""
    frame = sys._getframe(2)
    while frame is not None and ("jaxtyping" in frame.f_code.co_filename or frame.f_code.co_filename == __file__):
        frame = frame.f_back
    path = frame.f_code.co_filename if frame else ""
    return f"{path.removeprefix(SOURCE)}:{frame.f_lineno}" if frame and path.startswith(SOURCE) else None


@contextmanager
def second_device(found: list[str] | None = None) -> Iterator[str]:
    """Yield the name of the second device, which torch and Warp know while the block runs."""
    rules, real = Rules(found), SimpleNamespace(**{name: getattr(wp, name) for name in _WARP})

    def maker(name: str) -> Any:
        def make(*args: Any, device: Any = None, **kwargs: Any) -> Any:
            rules.check(f"wp.{name}", device)
            made = getattr(real, name)(*args, device="cpu" if device == SECOND else device, **kwargs)
            made.second = device == SECOND
            return made

        return make

    def from_torch(tensor: torch.Tensor, **kwargs: Any) -> Any:
        made = real.from_torch(tensor.held if isinstance(tensor, OnSecond) else tensor, **kwargs)
        made.second = isinstance(tensor, OnSecond)
        return made

    def tree(name: str) -> Any:
        def make(*args: Any, **kwargs: Any) -> Any:
            made = getattr(real, name)(*args, **kwargs)
            (rules.trees[int(made.id)],) = {
                side for each in (*args, *kwargs.values()) for side in rules.on_second(each)
            }
            return made

        return make

    def launch(kernel: Any, *args: Any, inputs: Any = (), outputs: Any = (), device: Any = None, **kwargs: Any) -> Any:
        rules.check(f"launch of {kernel.key}", device)
        sides = {side for value in [*inputs, *outputs] for side in rules.on_second(value)}
        if sides - {device == SECOND}:
            rules.lost(f"{kernel.key} on {device}: arrays on another device")
        on = "cpu" if device == SECOND else device
        return real.launch(kernel, *args, inputs=inputs, outputs=outputs, device=on, **kwargs)

    def get_device(name: Any = None) -> Any:
        return SimpleNamespace(is_cpu=False, is_cuda=False) if name == SECOND else real.get_device(name)

    def load_module(module: Any = None, device: Any = None, **kwargs: Any) -> Any:
        return real.load_module(module, device="cpu" if device == SECOND else device, **kwargs)

    ways = {name: maker(name) for name in ("array", "empty", "zeros", "full")}
    ways |= {
        "from_torch": from_torch,
        "Mesh": tree("Mesh"),
        "Bvh": tree("Bvh"),
        "launch": launch,
        "get_device": get_device,
    }
    with ExitStack() as stack:
        for name, way in (ways | {"load_module": load_module}).items():
            stack.enter_context(patch.object(wp, name, way))
        # Views of wrapped tensors cannot be made in inference mode.
        stack.enter_context(patch.object(torch, "inference_mode", lambda mode=True: torch.set_grad_enabled(not mode)))
        stack.enter_context(Dispatch())
        stack.enter_context(Makers(rules))
        yield SECOND


_WARP = ("array", "empty", "zeros", "full", "from_torch", "Mesh", "Bvh", "launch", "get_device", "load_module")
