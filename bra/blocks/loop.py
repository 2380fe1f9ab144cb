"""A recorded update, done by all agents, again and again, in one call of compiled code.

    for i in range(count): state, slots, terms = update(state, slots, inputs of update first + i)

The body is the update with the agents in the last dimension (`bra.blocks.agents_last`). Body and
loop are compiled ahead of time, for any count up to a capacity, and what the compiler makes is kept
in `cache_folder()`: one file of some two megabytes for each kind of update, agents and processor.
"""

import gc
import hashlib
import logging
import math
import os
import platform
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import copy_context
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch._guards import TracingContext, tracing
from torch._higher_order_ops.while_loop import while_loop_op
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

from bra.blocks.agents_last import AgentsLast
from bra.blocks.recording import Recorded
from bra.blocks.traces import Untraceable

logger = logging.getLogger(__name__)

OPTIONS: dict[str, Any] = {
    "aot_inductor.compile_wrapper_opt_level": "Og",  # the code between kernels
    "aot_inductor.precompile_headers": False,  # which takes longer than one file wins back
    "cpp.enable_floating_point_contract_flag": "fast",  # a product and a sum in one instruction
    "cpp.use_decompose_tanh": True,  # by exp, to the same precision
    "cpp.vec_isa_ok": True,  # what the processor has, compilers know
}


def cache_folder() -> Path:
    """Where compiled code is kept: `bra/blocks` in `$XDG_CACHE_HOME`, or in `~/.cache`."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "bra" / "blocks"


@dataclass(frozen=True)
class Inputs:
    """Inputs of a block, with the agents last in what each has of its own.

    Attributes:
        kept: State and slots, in the order of the recorded update.
        stacked: Of each update, with room for a capacity of them: prices, rates, states, signals.
        fixed: The scales of the agents' rates, the keys of their streams, and the constants.
        own: Whether each agent has its own of each: of `kept`, prices, scales, rates, states,
            signals, number of the update, keys and constants.
        agents: R′, in the last dimension.
    """

    kept: tuple[Tensor, ...]
    stacked: tuple[Tensor, ...]
    fixed: tuple[Tensor, ...]
    own: tuple[bool, ...]
    agents: int


class Packed:
    """Tensors of the same kind and last dimension as one: each that a loop carries costs it time.

    Args:
        tensors: Any.

    Attributes:
        tensors: The same.
        parts: How many there are once they are packed.
    """

    def __init__(self, tensors: Sequence[Tensor]) -> None:
        self.tensors = [*tensors]
        kinds = [(t.dtype, t.device, t.shape[-1:]) for t in tensors]
        self._places = [[*dict.fromkeys(kinds)].index(kind) for kind in kinds]
        self.parts = len({*kinds})

    def pack(self, tensors: Sequence[Tensor]) -> list[Tensor]:
        """(rows, length) of each kind, from tensors like those."""
        rows: list[list[Tensor]] = [[] for _ in range(self.parts)]
        for tensor, place in zip(tensors, self._places, strict=True):
            length = tensor.shape[-1] if tensor.ndim else 1
            rows[place].append(tensor.reshape(math.prod(tensor.shape[:-1]), length))
        return [torch.cat(part) for part in rows]

    def unpack(self, parts: Sequence[Tensor]) -> list[Tensor]:
        """The tensors that were packed."""
        left = [*parts]
        found = []
        for tensor, place in zip(self.tensors, self._places, strict=True):
            rows = math.prod(tensor.shape[:-1])
            found.append(left[place][:rows].view(tensor.shape))
            left[place] = left[place][rows:]
        return found


class Loop(nn.Module):
    """Makes updates one after the other.

    Args:
        body: One update of all agents.
        changed: Which of state and slots it changes.
        terms: Zeros like the terms of J that it returns.
    """

    def __init__(self, body: GraphModule, changed: Sequence[bool], terms: list[Tensor]) -> None:
        super().__init__()
        self.body, self.changed = body, tuple(changed)
        self.terms = [(term.shape, term.dtype, term.device) for term in terms]

    def forward(
        self,
        first: Tensor,
        count: Tensor,
        kept: tuple[Tensor, ...],
        stacked: tuple[Tensor, ...],
        fixed: tuple[Tensor, ...],
    ) -> tuple[Tensor, ...]:
        """What changes of state and slots, and the last terms of J, after `count` updates."""
        moving = [tensor for tensor, changes in zip(kept, self.changed, strict=True) if changes]
        still = [tensor for tensor, changes in zip(kept, self.changed, strict=True) if not changes]
        terms = [torch.zeros(s, dtype=t, device=d) for s, t, d in self.terms]
        carried, given = Packed([*moving, *terms]), Packed([*still, *fixed])

        def goes_on(number: Tensor, *values: Tensor) -> Tensor:
            return number < values[-1]

        def update(number: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
            values, first = values[:-2], values[-2]
            now = iter(carried.unpack(values[: carried.parts]))
            constant = iter(given.unpack(values[carried.parts : -len(stacked)]))
            own = [next(now if changes else constant) for changes in self.changed]
            place = number.unsqueeze(0)
            prices, rates, states, signals = (
                s.index_select(0, place)[0] for s in values[-len(stacked) :]
            )
            scales, keys, *constants = constant
            worlds = (states, signals, first + number, keys)
            found = self.body(*own, prices, scales, rates, *worlds, *constants)
            return number + 1, *carried.pack(found)

        others = (*given.pack(given.tensors), *stacked, first, count)
        initial = (torch.zeros_like(first), *carried.pack(carried.tensors))
        # Called directly, since `while_loop` would have dynamo trace the body once more.
        _, *found = while_loop_op(goes_on, update, initial, others)  # type: ignore[arg-type]
        return tuple(carried.unpack(found))


def compile_loop(recorded: Recorded, inputs: Inputs) -> Any:
    """The loop as compiled code, called like `Loop.forward`.

    Args:
        recorded: An update of one agent.
        inputs: Like those that it will get.

    Raises:
        Untraceable: If it cannot be compiled.
    """
    path = cache_folder() / f"{_fingerprint(recorded, inputs)}.pt2"
    try:
        with _compiler():
            if path.exists():
                with suppress(Exception):  # a damaged file is made anew
                    return torch._inductor.aoti_load_package(str(path))
            logger.info("compiling updates, once for all runs of this kind; kept in %s", path)
            with ThreadPoolExecutor(1) as beside:  # a second, which torch would wait for
                beside.submit(copy_context().run, _try_vectors)
                _compile(recorded, inputs, path)
            return torch._inductor.aoti_load_package(str(path))
    except Exception as error:  # compilers fail in ways of their own
        raise Untraceable(
            f"compiling failed: {str(error).strip().partition(chr(10))[0]}"
        ) from error


def _compile(recorded: Recorded, inputs: Inputs, path: Path) -> None:
    agents = AgentsLast(recorded.graph, inputs.agents)
    moving = [own for own, changes in zip(inputs.own, recorded.changed, strict=False) if changes]
    own_outputs = [*moving, *[True] * len(recorded.terms)]

    def body(*values: Tensor) -> tuple[Tensor, ...]:
        return agents(inputs.own, values, own_outputs)

    of_one = [stack[0] for stack in inputs.stacked]
    prices, rates, states, signals = of_one
    scales, keys, *constants = inputs.fixed
    number = torch.zeros((), dtype=torch.long, device=keys.device)
    flat = [*inputs.kept, prices, scales, rates, states, signals, number, keys, *constants]
    with tracing(TracingContext(FakeTensorMode())):  # as in `record`
        graph = make_fx(body)(*flat)
    terms = [*graph(*flat)][sum(recorded.changed) :]
    loop = Loop(graph, recorded.changed, terms)
    args = (number, number.clone(), inputs.kept, inputs.stacked, inputs.fixed)
    exported = torch.export.export(loop, args, strict=False)
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = Path(folder) / path.name
        torch._inductor.aoti_compile_and_package(exported, package_path=str(made))
        made.replace(path)


def _try_vectors() -> None:
    """Finds out, once, which vectors the processor and the compiler have."""
    from torch._inductor.cpu_vec_isa import pick_vec_isa

    pick_vec_isa()


@contextmanager
def _compiler() -> Iterator[None]:
    """Within, torch compiles with our options, and tells nothing of compilers it does not need.

    It loads with them, too: it compares processors then, and would try them out. Python does not
    look for garbage, of which there is little: that would be a sixth of torch's time.
    """
    known = torch._inductor.list_options()  # which differ between versions
    options = {name: value for name, value in OPTIONS.items() if name in known}
    talkative = logging.getLogger("torch.utils.cpp_extension")
    level, collects = talkative.level, gc.isenabled()
    talkative.setLevel(logging.ERROR)
    gc.disable()
    try:
        with torch._inductor.config.patch(options):
            yield
    finally:
        talkative.setLevel(level)
        if collects:
            gc.enable()


def _fingerprint(recorded: Recorded, inputs: Inputs) -> str:
    """Changes with whatever the compiled code depends on."""
    tensors = (*inputs.kept, *inputs.stacked, *inputs.fixed)
    parts = [
        recorded.graph.code,
        str([(tuple(t.shape), t.dtype, t.device.type) for t in tensors]),
        str((inputs.own, recorded.changed, torch.__version__, torch.get_num_threads())),
        str(torch.cuda.get_device_name(tensors[0].device) if tensors[0].is_cuda else _processor()),
        *(path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("*.py"))),
    ]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _processor() -> str:
    """What instructions there are, for which compilers make different code."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return "\n".join(sorted({x for x in lines if x.startswith(("flags", "Features"))}))
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
