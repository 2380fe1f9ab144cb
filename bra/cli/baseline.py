"""`bra baseline`: the optimum of a configuration, without training."""

import json
import logging

from bra.agent.learner import Learner
from bra.blahut_arimoto import General, Serial
from bra.callbacks.baseline import solve_reference
from bra.callbacks.schedule import agent_of
from bra.cli.errors import fail
from bra.evaluation.references import Reference
from bra.objective import bits, digits
from bra.population import Population


def solve_baseline(model: Learner, certify: float | None = None) -> Reference:
    """The optimum of a model's problem; ends the command if there is none, or more than one.

    Certifying takes long: its progress is written to standard error.
    """
    agent = agent_of(model)
    if isinstance(model, Population) and len({s.prices for s in model.settings}) > 1:
        fail("baseline solves for one pair of prices, got lists; give one beta of each kind")
    if certify is not None:
        logging.basicConfig(format="%(message)s")
        logging.getLogger("bra.blahut_arimoto").setLevel(logging.INFO)
    try:
        reference = solve_reference(agent, certify=certify)
    except ValueError as error:
        fail(str(error))
    if reference.optimum is None:
        fail(
            "baseline needs a task with a table of utilities or a grid, Discrete percepts and a "
            f"sensor that is known: {reference.reason}"
        )
    return reference


def baseline_json(reference: Reference) -> str:
    """The optimum for programs, information in nats."""
    optimum = reference.optimum
    assert optimum is not None
    direct = {}
    if isinstance(optimum, General):
        direct = {
            "direct_information_nats": optimum.direct_information,
            "action_given_percept_and_state": optimum.action_given_percept_and_state.tolist(),
        }
    return json.dumps(
        {
            "objective": optimum.objective,
            "expected_utility": optimum.expected_utility,
            "perception_information_nats": optimum.perception_information,
            "action_information_nats": optimum.action_information,
            "end_to_end_information_nats": optimum.end_to_end_information,
            "error": reference.error,
            "objective_without_sensor_noise": reference.objective_without_noise,
            "upper_bound": reference.upper_bound,
            "tight_bound": reference.tight_bound,
            "bound": reference.bound,
            "nodes": optimum.nodes,
            "closed": optimum.closed,
            "optima": optimum.optima.tolist(),
            "starts": optimum.starts,
            "hits": optimum.hits,
            "iterations": optimum.iterations,
            "converged": optimum.converged,
            "action_given_state": optimum.action_given_state.tolist(),
            "percept_given_state": optimum.percept_given_state.tolist(),
            "action_given_percept": optimum.action_given_percept.tolist(),
            **direct,
        },
        indent=2,
    )


def baseline_text(reference: Reference) -> str:
    """The optimum for people, information in bits."""
    optimum, error = reference.optimum, reference.error
    assert optimum is not None
    bounds = [
        ("upper", reference.upper_bound, "whatever the percepts"),
        ("tight", reference.tight_bound, "for so many percepts"),
        ("least", reference.bound, _verdict(optimum)),
    ]
    if isinstance(optimum, General):  # which has one bound
        bounds = bounds[1:2]
    signal = "Ω" if reference.without_noise is None else "ξ"
    known = "up to the error of J" if error else "certified"
    lines = [
        f"J            {digits(float(optimum.objective), error)}   best of {optimum.starts} "
        f"starts; {optimum.hits} lead to it, the worst to {optimum.optima.min().item():.5f}",
        *(f"{n} bound  {digits(b, error)}   {known}, {to}" for n, b, to in bounds if b is not None),
        f"E[U]         {optimum.expected_utility:.5f}",
        f"I({signal};X)       {bits(float(optimum.perception_information)):.4f} bits",
        f"I(X;A)       {bits(float(optimum.action_information)):.4f} bits",
        f"I(Ω;A)       {bits(float(optimum.end_to_end_information)):.4f} bits",
    ]
    if isinstance(optimum, General):
        lines.insert(-1, f"I(Ω;A|X)     {bits(float(optimum.direct_information)):.4f} bits")
    if reference.objective_without_noise is not None:
        lines.insert(
            1, f"             {reference.objective_without_noise:.5f}   without sensor noise"
        )
    return "\n".join(lines + ([f"note: {reference.note}"] if reference.note else []))


def _verdict(optimum: Serial) -> str:
    gap = f"it leaves a gap of {optimum.bound - optimum.objective:.5f}"
    boxes = f" after {optimum.nodes} boxes" if optimum.nodes else ""
    return f"{gap}{boxes}, {'closed' if optimum.closed else '--certify SECONDS makes it smaller'}"
