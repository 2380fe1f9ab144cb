"""What the paper's on-line rule reaches from many seeds at once.

    python benchmarks/paper_rule_seeds.py --config configs/nao_mugs_online/high.yaml [--seeds 64]

The protocol of Peng et al. (2017) as in `paper_rule.py`, with all seeds as one batch of matrices:
the start of every agent is that of `bra fit` with its seed, the encounters are drawn otherwise. The
gradient of one encounter is checked against the agent's own code. Prints a row of a Markdown table:
β₁, β₂, lowest, median and highest J, the optimum, and how many seeds end within 0.005 of it.
"""

import argparse
import statistics

import torch
from paper_rule import build
from torch import Tensor

from bra import Agent
from bra.blahut_arimoto import serial
from bra.cli import quieten
from bra.objective import sampled_objective, table_objective
from bra.recipes import from_recipe

Weights = tuple[Tensor, Tensor, Tensor]
"""V (S, inputs, hidden), W (S, hidden, X) and η with its row of zeros left out (S, A − 1, X)."""


def channels(weights: Weights, signals: Tensor) -> tuple[Tensor, Tensor]:
    """Logarithms of softmax(tanh(ξᵀV) W), p(x|ω), (S, W, X), and softmax(η), p(a|x), (S, X, A)."""
    first, last, eta = weights
    logits = torch.cat([torch.zeros_like(eta[:, :1]), eta], 1).transpose(1, 2)
    return (torch.tanh(signals @ first) @ last).log_softmax(-1), logits.log_softmax(-1)


def gradients(
    weights: Weights, task: tuple[Tensor, Tensor, Tensor], betas: tuple[float, float], drawn: Tensor
) -> tuple[Tensor, ...]:
    """∂/∂weights of [log p(x|ω) + log p(a|x)] j at one encounter ω, x, a per seed.

    Args:
        weights: Of all seeds.
        task: Signals (W, inputs), prior (W,), utilities (W, A).
        betas: β₁ and β₂, per nat.
        drawn: Uniform numbers, (3, S), that ω, x and a are drawn with.
    """
    signals, prior, utilities = task
    log_percept, log_action = channels(weights, signals)
    seeds = torch.arange(len(drawn[0]))
    with torch.no_grad():
        p_percept, p_action = log_percept.exp(), log_action.exp()
        percept_marginal = prior @ p_percept
        action_marginal = (percept_marginal.unsqueeze(1) @ p_action).squeeze(1)
        state = pick(prior.expand(len(seeds), -1), drawn[0])
        percept = pick(p_percept[seeds, state], drawn[1])
        action = pick(p_action[seeds, percept], drawn[2])
    percept_score = log_percept[seeds, state, percept]
    action_score = log_action[seeds, percept, action]
    with torch.no_grad():
        j = sampled_objective(
            utilities[state, action],
            percept_score - percept_marginal[seeds, percept].log(),
            action_score - action_marginal[seeds, action].log(),
            *betas,
        )
    return torch.autograd.grad(((percept_score + action_score) * j).sum(), weights)


def pick(probabilities: Tensor, uniform: Tensor) -> Tensor:
    """One outcome per row by inversion of the distribution function, (S,)."""
    below = probabilities.cumsum(-1) < uniform.unsqueeze(-1) * probabilities.sum(-1, keepdim=True)
    return below.sum(-1).clamp_max(probabilities.shape[-1] - 1)


def start(agent: Agent) -> Weights:
    """An agent's parameters."""
    first, last = (parameter.detach().T for parameter in agent.perception.parameters())
    (eta,) = (parameter.detach() for parameter in agent.action.parameters())
    return first, last, eta


def check(agent: Agent, problem: tuple[Tensor, Tensor, Tensor], betas: tuple[float, float]) -> None:
    """The gradient at one encounter is that of the score function through the agent's own code."""
    chain, prior = agent.chain, problem[1]
    drawn = torch.tensor([[0.3], [0.6], [0.7]])
    weights = tuple(weight.unsqueeze(0).requires_grad_() for weight in start(agent))
    ours = gradients(weights, problem, betas, drawn)
    state = pick(prior.unsqueeze(0), drawn[0])
    percept_given = chain.perception(agent.task.states().observation[state])
    percept = pick(percept_given.probs, drawn[1])
    action_given = chain.action(percept)
    action = pick(action_given.probs, drawn[2])
    score = percept_given.log_prob(percept) + action_given.log_prob(action)
    with torch.no_grad():
        every = chain.perception(agent.task.states().observation)
        marginal = chain.marginals.percept(agent.task, chain.perception, every, state.device)
        j = sampled_objective(
            agent.task.utility(state, action),
            percept_given.log_prob(percept) - marginal.log_prob(percept),
            action_given.log_prob(action)
            - chain.marginals.action(chain.action, marginal, percept).log_prob(action),
            *betas,
        )
    agent.zero_grad()
    (score * j).sum().backward()
    theirs = [parameter.grad for parameter in agent.parameters()]
    for one, other in zip(ours, (theirs[0].T, theirs[1].T, theirs[2]), strict=True):
        torch.testing.assert_close(one[0], other, rtol=1e-4, atol=1e-6)


def main() -> None:
    """Trains and prints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", required=True)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--updates", type=int, default=100_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    quieten()
    agent = build(options.config, 0, 0)
    recipe = {part: value for part, value in agent.recipe.items() if part not in ("task", "seed")}
    agents = [Agent(agent.task, **from_recipe(recipe), seed=seed) for seed in range(options.seeds)]
    signals = agent.task.states().observation.flatten(1)
    problem = (signals, agent.task.prior.float(), agent.task.utilities.float())
    betas = (agent.beta_perception, agent.beta_action)
    check(agent, problem, betas)

    perception, action = (one.param_groups[0]["lr"] for one in agent.configure_optimizers()[0])
    rates = (perception, perception, action)
    starts = zip(*map(start, agents), strict=True)
    weights = tuple(torch.stack(parts).requires_grad_() for parts in starts)
    generator = torch.Generator().manual_seed(0)
    for _ in range(options.updates):
        drawn = torch.rand(3, options.seeds, generator=generator)
        steps = gradients(weights, problem, betas, drawn)
        with torch.no_grad():
            for weight, step, rate in zip(weights, steps, rates, strict=True):
                weight.add_(step, alpha=rate)

    with torch.no_grad():
        tables = [table.exp().double() for table in channels(weights, signals)]
    prior, utilities = agent.task.prior, agent.task.utilities
    reached = [
        table_objective(prior, percept, action, utilities, *betas).objective.item()
        for percept, action in zip(*tables, strict=True)
    ]
    best = serial(utilities, prior, int(agent.percept_space.n), *betas).objective
    hits = sum(best - objective < 0.005 for objective in reached)
    print(
        f"| {betas[0]:g}, {betas[1]:g} | {min(reached):.3f} | {statistics.median(reached):.3f} "
        f"| {max(reached):.3f} | {best:.4f} | {hits} of {len(reached)} |"
    )


if __name__ == "__main__":
    main()
