"""Normalising probabilities with the exponentials that their logarithms need anyway."""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch.fx import Graph, GraphModule, Node

aten = torch.ops.aten


def share_exponentials(recorded: GraphModule) -> None:
    """Rewrites exp(x − log Σ exp x) as exp(x − m) / Σ exp(x − m), m the largest x, in place.

    Also where the logarithm is torch's `log_softmax`, which is spelt out first, and in its gradient
    g − p Σ g.

    Distributions are kept as log-probabilities x − log Σ exp x, which are normalised by the sum of
    exp(x − m). So probabilities need no exponentials of their own, which are half of the arithmetic
    of an update.

    Args:
        recorded: Operations without side effects on x.
    """
    for node in [*recorded.graph.nodes]:
        if node.target in SAME:
            node.replace_all_uses_with(node.args[0])
        elif node.target in SPELT_OUT:
            with recorded.graph.inserting_before(node):
                node.replace_all_uses_with(SPELT_OUT[node.target](recorded.graph, *node.args))
    for node in [*recorded.graph.nodes]:
        if node.target is aten.logsumexp.default and _probabilities(node):
            _rewrite(node)
    recorded.graph.eliminate_dead_code()
    recorded.recompile()


def _log_softmax(graph: Graph, x: Node, dim: int, half_to_float: bool) -> Node:
    normaliser = graph.call_function(aten.logsumexp.default, (x, [dim], True))
    return graph.call_function(aten.sub.Tensor, (x, normaliser))


def _log_softmax_gradient(
    graph: Graph, gradient: Node, output: Node, dim: int, dtype: torch.dtype
) -> Node:
    total = graph.call_function(aten.sum.dim_IntList, (gradient, [dim], True))
    p = graph.call_function(aten.exp.default, (output,))
    return graph.call_function(
        aten.sub.Tensor, (gradient, graph.call_function(aten.mul.Tensor, (p, total)))
    )


SAME = (aten.alias.default, aten.detach.default)
SPELT_OUT: dict[Any, Callable[..., Node]] = {
    aten._log_softmax.default: _log_softmax,
    aten._log_softmax_backward_data.default: _log_softmax_gradient,
}


def _probabilities(logarithm: Node) -> list[Node]:
    """The nodes exp(x − log Σ exp x)."""
    differences = [user for user in logarithm.users if _is(user, aten.sub.Tensor)]
    return [
        user
        for difference in differences
        if difference.args == (logarithm.args[0], logarithm) and not difference.kwargs
        for user in difference.users
        if _is(user, aten.exp.default)
    ]


def _rewrite(logarithm: Node) -> None:
    x, dims, *keeps = logarithm.args
    if keeps != [True]:
        return
    graph = logarithm.graph

    def call(target: Any, *args: Any) -> Node:
        return graph.call_function(target, args)

    with graph.inserting_before(logarithm):
        largest = call(aten.amax.default, x, dims, True)
        infinite = call(aten.eq.Scalar, call(aten.abs.default, largest), math.inf)
        offset = call(aten.masked_fill.Scalar, largest, infinite, 0)
        exponentials = call(aten.exp.default, call(aten.sub.Tensor, x, offset))
        total = call(aten.sum.dim_IntList, exponentials, dims, True)
        normaliser = call(aten.add.Tensor, call(aten.log.default, total), offset)
        quotient = call(aten.div.Tensor, exponentials, total)
    for node in _probabilities(logarithm):
        node.replace_all_uses_with(quotient)
    logarithm.replace_all_uses_with(normaliser)


def _is(node: Node, target: Any) -> bool:
    return node.op == "call_function" and node.target is target
