"""What one agent does, done by many, with the agents in the last dimension of every tensor.

`torch.func.vmap` puts the agents first. The innermost loops that a compiler makes then run over the
outcomes of a channel, of which there are some ten or twenty. With the agents last they are as long
as there are agents, and all of them are vector instructions.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.fx import GraphModule, Interpreter
from torch.utils._pytree import tree_any, tree_flatten, tree_map_only, tree_unflatten

from bra.blocks.own import Own, Value, from_front, is_own, is_value, map_values, outcomes, places

aten = torch.ops.aten

SMALL = 2**14
"""Terms per agent up to which a product of matrices, or a sum by index, is one of elements."""
TOGETHER = 16
"""Rows of a product that are summed in one loop, which then reads the other matrix once,"""
FEW = 8
"""from so many agents on: for fewer, the views of the rows take longer."""

ELEMENTWISE = {aten._to_copy, aten.alias, aten.clone, aten.copy, aten.detach}
ELEMENTWISE |= {aten.full_like, aten.ones_like, aten.tanh_backward, aten.zeros_like}
BY_DIMENSION = {aten._log_softmax, aten._softmax, aten.amax, aten.amin, aten.cat, aten.gather}
BY_DIMENSION |= {aten.logsumexp, aten.mean, aten.select, aten.slice, aten.split, aten.squeeze}
BY_DIMENSION |= {aten.stack, aten.sum, aten.transpose, aten.unbind, aten.unsqueeze}
ONE_MORE = {aten.stack, aten.unsqueeze}
OVER_ALL = {aten.mean.default: aten.mean.dim, aten.sum.default: aten.sum.dim_IntList}


class AgentsLast(Interpreter):
    """Runs the operations of one agent for R of them.

    Operations that are not known here go through `torch.func.vmap`.

    Args:
        recorded: Operations of one agent, functional, that return a tuple.
        size: R.
    """

    def __init__(self, recorded: GraphModule, size: int) -> None:
        super().__init__(recorded)
        self.size = size

    def __call__(
        self, own: Sequence[bool], inputs: Sequence[Tensor], own_outputs: Sequence[bool]
    ) -> tuple[Tensor, ...]:
        """Outputs, (…, R) of what each agent has of its own.

        Args:
            own: For each input whether each agent has its own, or all share it.
            inputs: Tensors, (…, R) or shared, best contiguous.
            own_outputs: The same for each output.
        """
        values = [Own(t) if apart else t for apart, t in zip(own, inputs, strict=True)]
        outputs = self.run(*values)
        return tuple(
            self.spread(value) if apart else value
            for value, apart in zip(outputs, own_outputs, strict=True)
        )

    def call_function(self, target: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """One operation."""
        packet = getattr(target, "overloadpacket", None)
        if packet is None or not tree_any(is_own, (args, kwargs), is_leaf=is_own):
            return super().call_function(target, args, kwargs)
        found = RULES[packet](self, *args, **kwargs) if packet in RULES else None
        if found is not None:
            return found
        if packet in ELEMENTWISE or torch.Tag.pointwise in target.tags:
            return self.elementwise(target, *args, **kwargs)
        if packet in BY_DIMENSION and target is not aten.squeeze.default:
            return self._by_dimension(target, args, kwargs)
        return self._by_vmap(target, args, kwargs)

    def spread(self, value: Value) -> Tensor:
        """(…, R), also of what is shared."""
        if isinstance(value, Own):
            return value.tensor
        return value.unsqueeze(-1).expand(*value.shape, self.size)

    def elementwise(self, target: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """An operation that broadcasts."""
        values = [value for value in tree_flatten((args, kwargs), is_own)[0] if is_value(value)]
        kinds = {value.dtype for value in values if value.ndim}

        def align(value: Value) -> Tensor:
            if not isinstance(value, Own):
                return value.unsqueeze(-1) if value.ndim else value
            tensor, kind = value.tensor, next(iter(kinds), value.dtype)
            if value.ndim or kind.is_floating_point != value.dtype.is_floating_point:
                return tensor
            return tensor.to(kind)  # a number, which does not promote what has dimensions

        args, kwargs = map_values(align, (args, kwargs))
        return tree_map_only(Tensor, Own, target(*args, **kwargs))

    def _by_dimension(self, target: Any, args: Any, kwargs: Any) -> Any:
        """An operation that tells dimensions by number and keeps the others."""
        ndim = tree_flatten(args[0], is_own)[0][0].ndim + (target.overloadpacket in ONE_MORE)
        if not ndim:
            return self._by_vmap(target, args, kwargs)
        arguments = target._schema.arguments
        named = {a.name: a.default_value for a in arguments if a.has_default_value()}
        named |= dict(zip((a.name for a in arguments), args, strict=False)) | kwargs
        if target in OVER_ALL:
            target, named["dim"] = OVER_ALL[target], None
        for name in {"dim", "dim0", "dim1"} & named.keys():
            named[name] = from_front(named[name], ndim)
        return tree_map_only(Tensor, Own, target(**map_values(self.spread, named)))

    def _by_vmap(self, target: Any, args: Any, kwargs: Any) -> Any:
        leaves, structure = tree_flatten((args, kwargs), is_leaf=is_own)
        own = {index: leaf.tensor for index, leaf in enumerate(leaves) if is_own(leaf)}

        outputs: list[Any] = []
        shape: list[Any] = [None]

        def of_one(own: dict[int, Tensor]) -> Any:
            args, kwargs = tree_unflatten(
                [own.get(index, leaf) for index, leaf in enumerate(leaves)], structure
            )
            # Operations may leave out some of their outputs, which vmap does not.
            outputs[:], shape[0] = tree_flatten(target(*args, **kwargs))
            return tuple(leaf for leaf in outputs if leaf is not None)

        found = iter(torch.vmap(of_one, in_dims=-1, out_dims=-1)(own))
        return tree_unflatten(
            [None if leaf is None else Own(next(found)) for leaf in outputs], shape[0]
        )


Rule = Callable[..., Value | None]
"""Does an operation, or leaves it to others by None."""


def _view(agents: AgentsLast, value: Own, size: Sequence[int]) -> Own:
    given = math.prod(length for length in size if length != -1)
    lengths = [math.prod(value.shape) // given if length == -1 else length for length in size]
    return Own(value.tensor.reshape(*lengths, agents.size))


def _expand(agents: AgentsLast, value: Own, size: Sequence[int], implicit: bool = False) -> Own:
    return Own(value.tensor.expand(*size, agents.size))


def _new_zeros(agents: AgentsLast, value: Own, size: Sequence[int], **kwargs: Any) -> Tensor:
    return value.tensor.new_zeros(size, dtype=kwargs.get("dtype"))  # shared


def _permute(agents: AgentsLast, value: Own, dims: Sequence[int]) -> Own:
    return Own(value.tensor.permute(*from_front(dims, value.ndim), value.ndim))


def _transpose(agents: AgentsLast, value: Own) -> Own | None:
    return Own(value.tensor.transpose(0, 1)) if value.ndim == 2 else None


def _product(agents: AgentsLast, first: Value, second: Value) -> Own | None:
    """Σ_k a_ik b_kj, for batches too."""
    if math.prod(first.shape) * second.shape[-1] > SMALL:
        return None
    a, b = (v.tensor if isinstance(v, Own) else v.unsqueeze(-1) for v in (first, second))
    columns = b.transpose(-3, -2)
    if agents.size >= FEW and 1 < first.shape[-2] <= TOGETHER:
        rows = [(row.unsqueeze(-3) * columns).sum(-2) for row in a.unbind(-3)]
        return Own(torch.stack(rows, -3))
    return Own((a.unsqueeze(-3) * columns.unsqueeze(-4)).sum(-2))


def _product_and_sum(
    agents: AgentsLast, bias: Value, first: Value, second: Value, beta: float = 1, alpha: float = 1
) -> Own | None:
    found = _product(agents, first, second)
    if found is None or beta != 1 or alpha != 1:
        return None
    total: Own = agents.elementwise(aten.add.Tensor, bias, found)
    return total


def _cumsum(agents: AgentsLast, value: Own, dim: int) -> Own | None:
    """Σ_{j≤i} x_j, term by term, since compilers have no vectors for running sums."""
    if not value.ndim or math.prod(value.shape) * value.shape[dim] > SMALL:
        return None
    dim = from_front(dim, value.ndim)
    count = torch.arange(value.shape[dim], device=value.tensor.device)
    beyond = (count > count.unsqueeze(1)).reshape(*count.shape * 2, *[1] * (value.ndim - dim))
    terms = value.tensor.unsqueeze(dim).masked_fill(beyond, 0)
    return Own(terms.sum(dim + 1))


def _index(agents: AgentsLast, value: Value, indices: Sequence[Value | None]) -> Own | None:
    used = [index for index in indices if index is not None]
    if any(index.dtype != torch.long for index in used):
        return None
    if not isinstance(value, Own):
        if len(used) < value.ndim:
            return None
        return Own(value[tuple(agents.spread(index) for index in used)])
    if len(used) > 1 or math.prod((*value.shape, *used[0].shape)) > SMALL:
        return None
    dim = len(indices) - 1
    index = places(agents.spread(used[0]), value.shape[dim])
    before, after = value.shape[:dim], value.shape[dim + 1 :]
    flat = index.reshape(*[1] * dim, -1, 1, *[1] * len(after), agents.size)
    outcome = outcomes(value, dim)
    terms = torch.where(flat == outcome, value.tensor.unsqueeze(dim), 0)
    found = terms.sum(dim + 1, dtype=value.dtype)
    return Own(found.reshape(*before, *index.shape[:-1], *after, agents.size))


def _index_put(
    agents: AgentsLast,
    value: Value,
    indices: Sequence[Value | None],
    source: Value,
    accumulate: bool = False,
) -> Own | None:
    (index,) = indices if len(indices) == 1 else (None,)
    if index is None or index.ndim != 1 or index.dtype != torch.long:
        return None
    if not accumulate or source.shape != (*index.shape, *value.shape[1:]):
        return None
    flat = agents.spread(index).reshape(-1, *[1] * (source.ndim - 1), agents.size)
    return _scatter_add(agents, value, 0, Own(flat.expand(*source.shape, -1)), source)


def _scatter_add(
    agents: AgentsLast, value: Value, dim: int, index: Value, source: Value
) -> Own | None:
    """y_i + Σ_n [index_n = i] x_n."""
    if not value.ndim or math.prod(source.shape) * value.shape[dim] > SMALL:
        return None
    dim = from_front(dim, value.ndim)
    shape = list(value.shape)
    shape[dim] = source.shape[dim]
    if not source.shape == index.shape == torch.Size(shape):
        return None
    own, index = agents.spread(source), places(agents.spread(index), value.shape[dim])
    outcome = outcomes(value, dim).unsqueeze(1)
    terms = torch.where(index.unsqueeze(dim) == outcome, own.unsqueeze(dim), 0)
    added = Own(terms.sum(dim + 1, dtype=own.dtype))
    total: Own = agents.elementwise(aten.add.Tensor, value, added)
    return total


RULES: dict[Any, Rule] = {
    aten._unsafe_view: _view,
    aten.addmm: _product_and_sum,
    aten.bmm: _product,
    aten.cumsum: _cumsum,
    aten.expand: _expand,
    aten.index: _index,
    aten.index_put: _index_put,
    aten.mm: _product,
    aten.new_zeros: _new_zeros,
    aten.permute: _permute,
    aten.scatter_add: _scatter_add,
    aten.t: _transpose,
    aten.view: _view,
}
