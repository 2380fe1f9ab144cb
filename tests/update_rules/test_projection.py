"""The projection rule: its gradient, its fixed points, its relation to the gradient of J."""

import pytest
import torch
from projected import BETA_1, BETA_2, Hidden, checked, gradients, make_chain

from bra import blahut_arimoto
from bra.channels import Multinomial, Table
from bra.channels.distributions import probabilities
from bra.marginals import BatchMarginals
from bra.objective import table_objective
from bra.tasks import PredatorPrey, TableTask
from bra.update_rules import ExactGradient
from bra.update_rules.targets import cross_entropy


def right_hand_sides(prior, percept_given, action_given, utilities, beta_1=BETA_1, beta_2=BETA_2):
    """p*(x|ω) and p*(a|x) by plain sums over probabilities, in float64."""
    p_x = prior @ percept_given
    p_a = p_x @ action_given
    states_given = prior[:, None] * percept_given / p_x
    cost = (action_given * (action_given / p_a).log()).sum(1)
    free_energy = utilities @ action_given.T - cost / beta_2
    return (
        (p_x.log() + beta_1 * free_energy).softmax(1),
        (p_a.log() + beta_2 * states_given.T @ utilities).softmax(1),
    )


def tables(chain):
    percept_given = probabilities(chain.perception(chain.task.observations)).detach()
    percepts = torch.arange(percept_given.shape[1])
    return percept_given.double(), probabilities(chain.action(percepts)).detach().double()


def test_the_logit_gradient_is_channel_minus_target():
    chain = make_chain()
    prior = chain.task.prior
    loss, _ = checked(chain).loss(chain, chain.task.states())
    percept_given, action_given = tables(chain)
    targets = right_hand_sides(prior, percept_given, action_given, chain.task.utilities)
    by_perception, by_action = gradients(chain, loss)
    expected = prior[:, None] * (percept_given - targets[0])
    torch.testing.assert_close(by_perception, expected, rtol=0, atol=1e-7)
    expected = (prior @ percept_given)[:, None] * (action_given - targets[1])
    torch.testing.assert_close(by_action, expected, rtol=0, atol=1e-7)
    assert min(by_perception.abs().max(), by_action.abs().max()) > 0.01


def test_the_loss_is_the_cross_entropy_to_the_targets():
    chain = make_chain()
    prior = chain.task.prior
    loss, terms = checked(chain).loss(chain, chain.task.states())
    percept_given, action_given = tables(chain)
    targets = right_hand_sides(prior, percept_given, action_given, chain.task.utilities)
    expected = -(prior @ (targets[0] * percept_given.log()).sum(1))
    expected -= prior @ percept_given @ (targets[1] * action_given.log()).sum(1)
    assert loss.item() == pytest.approx(expected.item(), rel=1e-6)
    exact = ExactGradient().loss(chain, chain.task.states())[1]
    for name in ("objective", "expected_utility", "perception_information", "action_information"):
        assert getattr(terms, name).item() == pytest.approx(getattr(exact, name).item(), abs=1e-6)
        assert not getattr(terms, name).requires_grad


@pytest.mark.parametrize("perception", [Table, Multinomial], ids=["table", "multinomial"])
@pytest.mark.parametrize("action", [Table, Multinomial], ids=["table", "multinomial"])
@pytest.mark.parametrize("prices", [(8.0, 10.0), (8.0, 1.0), (1.0, 10.0), (1.0, 1.0)])
def test_a_blahut_arimoto_optimum_is_a_fixed_point(perception, action, prices):
    task = PredatorPrey(observations="index")
    beta_1, beta_2 = prices
    optimum = blahut_arimoto.serial(task.utilities, task.prior, 13, beta_1, beta_2, restarts=8)
    torch.set_default_dtype(torch.float64)
    try:
        chain = make_chain(task, perception, action, 13, beta_perception=beta_1, beta_action=beta_2)
        set_rows(chain.perception, optimum.percept_given_state)
        set_rows(chain.action, optimum.action_given_percept)
        rule = checked(chain)
        channels = [*chain.perception.parameters(), *chain.action.parameters()]
        for _ in range(20):
            loss, terms = rule.loss(chain, task.states())
            gradient = torch.autograd.grad(loss, channels)
            assert max(part.abs().max() for part in gradient) < 1e-6
            assert terms.objective.item() == pytest.approx(optimum.objective, abs=1e-9)
            with torch.no_grad():
                for parameter, part in zip(channels, gradient, strict=True):
                    parameter -= part
    finally:
        torch.set_default_dtype(torch.float32)


def set_rows(channel, rows):
    logits = rows.clamp_min(1e-300).log()
    with torch.no_grad():
        if isinstance(channel, Table):
            channel.logits.copy_(logits)
        else:
            channel.eta.copy_((logits[:, 1:] - logits[:, :1]).T)


def test_relation_to_the_gradient_of_j():
    # ∂J/∂ logit p(x|ω) = (1/β₁) p(ω) p(x|ω) [l(x) − Σ p(x'|ω) l(x')] with l = log p*/p, that of
    # −KL(p ‖ p*)/β₁; and the same for actions with β₂ and p(x).
    chain = make_chain()
    task, prior = chain.task, chain.task.prior
    logits = [chain.perception.logits.double(), chain.action.logits.double()]
    logits = [part.detach().requires_grad_() for part in logits]
    percept_given, action_given = (part.softmax(1) for part in logits)
    terms = table_objective(prior, percept_given, action_given, task.utilities, BETA_1, BETA_2)
    of_j = torch.autograd.grad(terms.objective, logits, retain_graph=True)

    channels = (percept_given.detach(), action_given.detach())
    targets = right_hand_sides(prior, *channels, task.utilities)
    weights = (prior, prior @ channels[0])
    rows = zip((percept_given, action_given), targets, weights, strict=True)
    parts = list(zip(rows, (BETA_1, BETA_2), logits, of_j, channels, strict=True))
    for (current, target, weight), beta, logit, gradient, p in parts:
        ratio = (target / p).log()
        derived = weight[:, None] * p * (ratio - (p * ratio).sum(1, keepdim=True)) / beta
        torch.testing.assert_close(gradient, derived, rtol=0, atol=1e-12)
        reverse = (weight @ (current * (current / target).log()).sum(1)) / beta
        (by_reverse,) = torch.autograd.grad(-reverse, logit, retain_graph=True)
        torch.testing.assert_close(gradient, by_reverse, rtol=0, atol=1e-12)
        # A natural-gradient step of length β on a row's logits leads to the target.
        fisher = torch.diag_embed(p) - p.unsqueeze(2) * p.unsqueeze(1)
        inverse = torch.linalg.pinv(fisher, rtol=1e-9, hermitian=True)
        natural = (inverse @ (gradient / weight[:, None]).unsqueeze(2)).squeeze(2)
        landed = (p.log() + beta * natural).softmax(1)
        torch.testing.assert_close(landed, target, rtol=0, atol=1e-9)


def test_an_improbable_percept_feels_the_projection_and_not_j():
    chain = make_chain(percepts=2)
    with torch.no_grad():  # both percepts occur; the third state is wrongly sure of the first
        chain.perception.logits.copy_(torch.tensor([[20.0, 0.0], [20.0, 0.0], [40.0, 0.0]]))
        chain.action.logits.copy_(torch.tensor([[4.0, 0.0, 0.0], [0.0, 0.0, 9.0]]))
        chain.perception.logits[1] = torch.tensor([0.0, 20.0])
    world = chain.task.states()
    by_projection = gradients(chain, checked(chain).loss(chain, world)[0])[0][2]
    by_j = gradients(chain, ExactGradient().loss(chain, world)[0])[0][2]
    assert by_projection.abs().max() > 0.1
    assert by_j.abs().max() < 1e-10


@pytest.mark.parametrize("scale", [1e3, 1e30])
def test_saturated_channels_have_finite_losses_and_gradients(scale):
    chain = make_chain(TableTask([[0.0, -1.0], [-1000.0, -1001.0]], observations="index"))
    with torch.no_grad():
        chain.perception.logits *= scale
        chain.action.logits *= scale
    loss, terms = checked(chain).loss(chain, chain.task.states())
    assert loss.isfinite()
    assert all(part.isfinite().all() for part in gradients(chain, loss))
    assert terms.objective.isfinite()


def test_over_many_worlds_the_batch_says_what_the_states_say():
    # 200 000 encounters of one batch: standard errors of the gradient's entries, means of numbers
    # below 1, are below 0.0023 times a few; six of them 0.02.
    hidden = make_chain(Hidden(), marginals=BatchMarginals())
    known = make_chain()
    world = hidden.task.sample(200_000, torch.Generator().manual_seed(0))
    sampled = checked(hidden).loss(hidden, world)
    exact = checked(known).loss(known, known.task.states())
    for ours, theirs in zip(gradients(hidden, sampled[0]), gradients(known, exact[0]), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=0.02)
    assert sampled[1].objective.item() == pytest.approx(exact[1].objective.item(), abs=0.03)


def test_what_a_target_leaves_out_costs_nothing_and_what_it_wants_and_is_impossible_everything():
    log_q = torch.tensor([0.5, 0.5, 0.0]).log().requires_grad_()
    loss = cross_entropy(torch.tensor([0.25, 0.75, 0.0]), log_q)
    loss.backward()
    torch.testing.assert_close(loss, torch.tensor(2.0).log())
    assert log_q.grad is not None and log_q.grad.tolist() == [-0.25, -0.75, 0.0]
    assert cross_entropy(torch.tensor([0.5, 0.25, 0.25]), log_q) == torch.inf
