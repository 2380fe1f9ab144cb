"""`bra baseline`: the optimum of a configuration, without training."""

import json

from bra.agent.learner import Learner
from bra.blahut_arimoto import Serial
from bra.callbacks.baseline import solve_optimum
from bra.callbacks.schedule import agent_of
from bra.cli.errors import fail
from bra.objective import bits
from bra.population import Population


def solve_baseline(model: Learner) -> Serial:
    """The optimum of a model's problem; ends the command if there is none, or more than one."""
    agent = agent_of(model)
    if isinstance(model, Population) and len({s.prices for s in model.settings}) > 1:
        fail("baseline solves for one pair of prices, got lists; give one beta of each kind")
    optimum = solve_optimum(agent)
    if optimum is None:
        fail(
            f"baseline needs a task with a table of utilities and Discrete percepts, got "
            f"{type(agent.task).__name__} and {agent.percept_space}"
        )
    return optimum


def baseline_json(optimum: Serial) -> str:
    """The optimum for programs, information in nats."""
    return json.dumps(
        {
            "objective": optimum.objective,
            "expected_utility": optimum.expected_utility,
            "perception_information_nats": optimum.perception_information,
            "action_information_nats": optimum.action_information,
            "end_to_end_information_nats": optimum.end_to_end_information,
            "upper_bound": optimum.upper_bound,
            "tight_bound": optimum.tight_bound,
            "optima": optimum.optima.tolist(),
            "starts": optimum.starts,
            "hits": optimum.hits,
            "iterations": optimum.iterations,
            "converged": optimum.converged,
            "action_given_state": optimum.action_given_state.tolist(),
            "percept_given_state": optimum.percept_given_state.tolist(),
            "action_given_percept": optimum.action_given_percept.tolist(),
        },
        indent=2,
    )


def baseline_text(optimum: Serial) -> str:
    """The optimum for people, information in bits."""
    lines = [
        f"J            {optimum.objective:.5f}   best of {optimum.starts} starts; "
        f"{optimum.hits} lead to it, the worst to {optimum.optima.min().item():.5f}",
        f"upper bound  {optimum.upper_bound:.5f}   certified, whatever the percepts",
        f"tight bound  {optimum.tight_bound:.5f}   certified, for so many percepts",
        f"E[U]         {optimum.expected_utility:.5f}",
        f"I(Ω;X)       {bits(float(optimum.perception_information)):.4f} bits",
        f"I(X;A)       {bits(float(optimum.action_information)):.4f} bits",
        f"I(Ω;A)       {bits(float(optimum.end_to_end_information)):.4f} bits",
    ]
    if optimum.hits == 1:
        lines.append("note: one start alone led to the best J; other seeds may find a better one")
    return "\n".join(lines)
