"""`bra baseline`: optima of a configuration, without training."""

import json
import logging
from collections.abc import Mapping, Sequence
from typing import Any

from gymnasium.spaces import Discrete

from bra.agent.learner import Learner
from bra.blahut_arimoto import AtRates, General, Serial, serial
from bra.callbacks.baseline import solve_all_references
from bra.callbacks.hits import Given
from bra.checks.words import amount
from bra.cli.errors import fail
from bra.evaluation.references import Prices, Reference
from bra.objective import bits, digits, finite
from bra.tasks import FiniteTask

INFORMATIONS = ("perception_information", "action_information", "end_to_end_information")


def report(model: Learner, as_json: bool, restarts: int, certify: float | None) -> str:
    """The optimum at each of a model's prices, or within its budgets, as text or as JSON."""
    if model.budgets:
        found = solve_within(model, restarts, certify)
        if as_json:
            entries = [within_fields(optimum) for optimum in found.values()]
            return json.dumps(entries if len(entries) > 1 else entries[0], indent=2)
        return within_table(found) if len(found) > 1 else within_text(*found.values())
    optima = solve_baselines(model, restarts, certify)
    return baselines_json(optima, model.beta_direct) if as_json else baselines_text(optima)


def solve_within(model: Learner, restarts: int, certify: float | None) -> dict[Given, AtRates]:
    """The optima within each of a model's pairs of budgets; ends the command if there are none."""
    task, percepts = model.task, model.best_agent().percept_space
    if (
        not (isinstance(task, FiniteTask) and task.noiseless and isinstance(percepts, Discrete))
        or model.beta_direct is not None
    ):
        fail(
            "baseline within budgets needs a table of utilities, a noiseless sensor, Discrete "
            "percepts and no beta_direct; give prices instead"
        )
    pairs = dict.fromkeys((setting.given_prices, setting.budgets) for setting in model.settings)
    return {
        (betas, limits): serial(
            task.utilities,
            task.prior,
            int(percepts.n),
            *betas,
            restarts,
            model.seed,
            certify=certify,
            perception_bits=limits[0],  # type: ignore[arg-type]  # one of them is a number
            action_bits=limits[1],
        )
        for betas, limits in pairs
    }


def within_fields(found: AtRates) -> dict[str, Any]:
    """An optimum within budgets in numbers, information in nats; its ends as optima are."""
    names = ("objective", "expected_utility", "beta_perception", "beta_action", "upper_bound")
    plain = {name: getattr(found, name) for name in (*names, "jump", "shares")}
    informations = {f"{name}_nats": getattr(found, name) for name in INFORMATIONS[:2]}
    ends = [optimum_fields(Reference(end, float(end.upper_bound))) for end in found.ends]
    return plain | informations | {"ends": ends}


def within_table(found: Mapping[Given, AtRates]) -> str:
    """Optima within several pairs of budgets for people, a row for each."""
    rows: list[tuple[str, ...]] = [("I(Ω;X)", "β₁", "I(X;A)", "β₂", "E[U]", "J", "bound", "")]
    for optimum in found.values():
        first, second = optimum.perception_information, optimum.action_information
        rates = f"{bits(first):.4f}", f"{bits(second):.4f}"
        prices = f"{optimum.beta_perception:.5g}", f"{optimum.beta_action:.5g}"
        values = optimum.expected_utility, optimum.objective, optimum.upper_bound
        of_both = (rates[0], prices[0], rates[1], prices[1])
        rows.append((*of_both, *(f"{v:.5f}" for v in values), "jump" * optimum.jump))
    foot = "information in bits; J is E[U] less what costs its price"
    jumps = any(optimum.jump for optimum in found.values())
    return "\n".join([*aligned(rows), foot + "; jump: no prices have these rates" * jumps])


def within_text(found: AtRates) -> str:
    """An optimum within budgets for people, information in bits."""
    gap = found.upper_bound - found.objective
    priced = found.objective != found.expected_utility
    worth = [f"J            {found.objective:.5f}   E[U] less what costs its price"] * priced
    lines = [
        f"E[U]         {found.expected_utility:.5f}",
        *worth,
        f"bound        {found.upper_bound:.5f}   certified, it leaves a gap of {gap:.5f}",
        f"I(Ω;X)       {bits(found.perception_information):.4f} bits, at β₁ "
        f"{found.beta_perception:.5g} per nat",
        f"I(X;A)       {bits(found.action_information):.4f} bits, at β₂ {found.beta_action:.5g} "
        "per nat",
    ]
    if found.jump:
        lines.append("no prices have these rates; optima at these prices that share the time:")
    for share, end in zip(found.shares, found.ends, strict=True):
        if found.jump:
            first, second = (bits(float(getattr(end, name))) for name in INFORMATIONS[:2])
            lines.append(
                f"  {share:7.2%}  E[U] {end.expected_utility:.5f}, I(Ω;X) {first:.4f} bits, "
                f"I(X;A) {second:.4f} bits"
            )
    return "\n".join(lines)


def solve_baselines(
    model: Learner, restarts: int, certify: float | None
) -> dict[Prices, Reference]:
    """The optima of a model's problem at all of its prices; ends the command if there are none.

    Certifying takes long: its progress is written to standard error.
    """
    if certify is not None:
        logging.basicConfig(format="%(message)s")
        logging.getLogger("bra.blahut_arimoto").setLevel(logging.INFO)
    try:
        references = solve_all_references(model, restarts, certify)
    except ValueError as error:
        fail(str(error))
    for reference in references.values():
        if reference.optimum is None:
            fail(
                "baseline needs a task with a table of utilities or a grid, Discrete percepts and "
                f"a sensor that is known: {reference.reason}"
            )
    return references


def baselines_json(references: Mapping[Prices, Reference], beta_direct: float | None = None) -> str:
    """The optima for programs, information in nats: an object, or a list of one for each pair.

    Args:
        references: By β₁ and β₂.
        beta_direct: β₃ of all of them, or None.
    """
    names = ("beta_perception", "beta_action")
    direct = {} if beta_direct is None else {"beta_direct": finite(beta_direct)}
    entries = [
        dict(zip(names, map(finite, prices), strict=True)) | direct | optimum_fields(reference)
        for prices, reference in references.items()
    ]
    return json.dumps(entries if len(entries) > 1 else entries[0], indent=2)


def baselines_text(references: Mapping[Prices, Reference]) -> str:
    """The optima for people: a row for each pair of prices, or all there is to say of one."""
    if len(references) == 1:
        return baseline_text(*references.values())
    head = ("β₁", "β₂", "J", "bound", "E[U]", "I(Ω;X)", "I(X;A)", "I(Ω;A)", "hits")
    rows = [head] + [_row(prices, reference) for prices, reference in references.items()]
    foot = "information in bits; hits: starts that lead to the best, of those there were"
    return "\n".join([*aligned(rows), foot])


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _row(prices: Prices, reference: Reference) -> tuple[str, ...]:
    optimum = reference.optimum
    assert optimum is not None
    bound = reference.bound
    return (
        *(f"{beta:g}" for beta in prices),
        digits(float(optimum.objective), reference.error),
        "–" if bound is None else digits(bound, reference.error),
        f"{optimum.expected_utility:.5f}",
        *(f"{bits(getattr(optimum, name)):.4f}" for name in INFORMATIONS),
        f"{optimum.hits}/{optimum.starts}",
    )


def optimum_fields(reference: Reference) -> dict[str, Any]:
    """An optimum in numbers."""
    optimum = reference.optimum
    assert optimum is not None
    direct: dict[str, Any] = {}
    if isinstance(optimum, General):
        direct = {
            "direct_information_nats": optimum.direct_information,
            "action_given_percept_and_state": optimum.action_given_percept_and_state.tolist(),
        }
    return {
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
        "optima": optimum.optima[~optimum.optima.isnan()].tolist(),
        "starts": optimum.starts,
        "hits": optimum.hits,
        "iterations": optimum.iterations,
        "converged": optimum.converged,
        "action_given_state": optimum.action_given_state.tolist(),
        "percept_given_state": optimum.percept_given_state.tolist(),
        "action_given_percept": optimum.action_given_percept.tolist(),
        **direct,
    }


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
    starts, hits = amount(int(optimum.starts), "start"), int(optimum.hits)
    lines = [
        f"J            {digits(float(optimum.objective), error)}   best of {starts}; {hits} "
        f"lead{'s' if hits == 1 else ''} to it, the worst to {optimum.optima.min().item():.5f}",
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
    boxes = f" after {amount(int(optimum.nodes), 'box', 'boxes')}" if optimum.nodes else ""
    return f"{gap}{boxes}, {'closed' if optimum.closed else '--certify SECONDS makes it smaller'}"
