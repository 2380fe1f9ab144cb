"""The projection rule: its gradient, its fixed points, its relation to the gradient of J."""

import math
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete

from bra import Agent, Cooling, blahut_arimoto
from bra.channels import MLP, Gaussian, Multinomial, Table
from bra.channels.distributions import probabilities
from bra.critics import TableCritic
from bra.marginals import BatchMarginals, ExactMarginals, RunningMarginals
from bra.objective import table_objective
from bra.tasks import PredatorPrey, TableTask, TargetTask, Task
from bra.update_rules import Chain, ExactGradient, Projection, Rivals

UTILITIES = [[2.0, 0.0, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]]
REGRETS = torch.tensor(UTILITIES) - torch.tensor(UTILITIES).amax(1, keepdim=True)
PRIOR = [0.5, 0.3, 0.2]
BETA_1, BETA_2 = 2.0, 3.0
NUMBER = Box(-np.inf, np.inf, shape=(1,), dtype=np.float32)


class Hidden(Task):
    """A finite task that does not say which states it has."""

    def __init__(self, utilities=UTILITIES, prior=PRIOR):
        self.table = TableTask(utilities, prior=prior, observations="index")
        self.observation_space = self.table.observation_space
        self.action_space = self.table.action_space

    def sample(self, count, generator):
        return self.table.sample(count, generator)

    def utility(self, state, action):
        return self.table.utility(state, action)


def make_chain(task=None, perception=Table, action=Table, percepts=4, marginals=None, **prices):
    task = task or TableTask(UTILITIES, prior=PRIOR, observations="index")
    torch.manual_seed(1)
    return Chain(
        task,
        perception(task.observation_space, Discrete(percepts)),
        action(Discrete(percepts), task.action_space),
        marginals or ExactMarginals(),
        **({"beta_perception": BETA_1, "beta_action": BETA_2} | prices),
    )


def checked(chain, **arguments):
    rule = Projection(**arguments)
    rule.check(chain)
    return rule


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


def gradients(chain, loss):
    logits = [chain.perception.logits, chain.action.logits]
    return [gradient.double() for gradient in torch.autograd.grad(loss, logits)]


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


def test_the_value_of_a_percept_is_an_average_by_hand():
    chain = make_chain(Hidden(), marginals=RunningMarginals())
    chain.marginals.check(chain.task, Discrete(4))
    rule = checked(chain, decay=0.5)
    generator, weighted, weight = torch.Generator().manual_seed(0), 0.0, 0.0
    for _ in range(5):
        world = chain.task.sample(1, generator)
        rule.loss(chain, world)
        percept_given = probabilities(chain.perception(world.observation)).detach()
        weighted = 0.5 * weighted + 0.5 * percept_given.T @ REGRETS[world.state]
        weight = 0.5 * weight + 0.5 * percept_given.sum(0)
        torch.testing.assert_close(rule.percept_value, weighted / weight[:, None])
        torch.testing.assert_close(rule.percept_log_weight.exp(), weight)
        with torch.no_grad():
            chain.perception.logits += 0.3
            chain.perception.logits[:, 0] -= 0.5


def test_a_percept_that_has_become_impossible_keeps_its_value():
    chain = make_chain(Hidden(), marginals=BatchMarginals())
    rule = checked(chain, decay=0.0)
    world = chain.task.sample(20, torch.Generator().manual_seed(0))
    with torch.no_grad():
        chain.perception.logits[:, 0] = -200.0  # e⁻²⁰⁰ is 0 in float32
    loss, _ = rule.loss(chain, world)
    others = chain.perception.logits[:, 1:].detach()[world.state]
    mean = (-others.logsumexp(1)).softmax(0) @ REGRETS[world.state]
    torch.testing.assert_close(rule.percept_value[0], mean, rtol=0, atol=1e-4)
    assert all(part.isfinite().all() for part in gradients(chain, loss))


@pytest.mark.parametrize(
    ("hidden", "arguments"),
    [(False, {}), (True, {}), (False, {"rivals": Rivals(2, 1, 2)})],
    ids=["known", "sampled", "rivals"],
)
def test_a_percept_that_no_state_reaches_counts_nothing(hidden, arguments):
    chain = make_chain(Hidden() if hidden else None, marginals=BatchMarginals())
    with torch.no_grad():
        chain.perception.logits[:, 0] = -math.inf
    rule = checked(chain, **arguments)
    world = chain.task.sample(20, torch.Generator().manual_seed(0))
    loss, terms = rule.loss(chain, world)
    assert loss.isfinite() and terms.objective.isfinite()
    assert all(part.isfinite().all() for part in gradients(chain, loss))
    fewer = make_chain(Hidden() if hidden else None, percepts=3, marginals=BatchMarginals())
    with torch.no_grad():
        fewer.perception.logits.copy_(chain.perception.logits[:, 1:])
        fewer.action.logits.copy_(chain.action.logits[1:])
    _, expected = checked(fewer).loss(fewer, world)
    assert terms.objective.item() == pytest.approx(expected.objective.item(), abs=1e-5)


@pytest.mark.parametrize("critic", [None, TableCritic(3.0)], ids=["asked", "learnt"])
def test_utilities_may_be_whole_numbers(critic):
    class Whole(Hidden):
        def utility(self, state, action):
            return super().utility(state, action).long()

    chain = make_chain(Whole(), marginals=BatchMarginals())
    rule = checked(chain, critic=critic)
    loss, _ = rule.loss(chain, chain.task.sample(20, torch.Generator().manual_seed(0)))
    assert loss.dtype == torch.float32


def test_averages_belong_to_the_state():
    chain = make_chain(Hidden(), marginals=BatchMarginals())
    rule, other = checked(chain), checked(chain)
    rule.loss(chain, chain.task.sample(20, torch.Generator().manual_seed(0)))
    other.load_state_dict(rule.state_dict())
    assert torch.equal(other.percept_value, rule.percept_value)
    assert rule.percept_value.abs().sum() > 0


@pytest.mark.parametrize("prices", [(8.0, 10.0), (8.0, 1.0), (1.0, 10.0), (1.0, 1.0), (0.5, 0.5)])
def test_with_a_covering_start_and_cooling_it_reaches_the_optimum(prices):
    task = PredatorPrey(observations="index")
    cooling = Cooling(factor=16.0, updates=200)
    agent = Agent(
        task,
        Table,
        partial(Multinomial, start="covering"),
        13,
        *prices,
        update_rule=Projection(),
        cooling=cooling,
        seed=1,
    )
    optimizer = torch.optim.Adam(agent.parameters(), lr=0.3)
    for _ in range(400):
        loss, _ = agent.update_rule.loss(agent.coming_chain(), task.states())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        agent.updates += 1
    optimum = blahut_arimoto.serial(task.utilities, task.prior, 13, *prices).objective
    assert agent.evaluate().objective == pytest.approx(optimum, abs=0.005)


@pytest.mark.parametrize("population", [3])
def test_a_population_is_trained_by_vmap(population):
    chains = []
    for seed in range(population):
        chain = make_chain(perception=partial(Table, spread=1.0 + seed))
        chains.append(chain)
    rule = checked(chains[0])
    states = chains[0].task.states()

    def loss(perception, action, beta):
        chain = chains[0]
        functional = Chain(
            chain.task,
            Functional(chain.perception, perception),
            Functional(chain.action, action),
            chain.marginals,
            beta,
            BETA_2,
        )
        return rule.loss(functional, states)[0]

    stacked = [
        torch.stack([getattr(chain, channel).logits.detach() for chain in chains])
        for channel in ("perception", "action")
    ]
    betas = torch.tensor([1.0, 2.0, 3.0])
    together = torch.func.vmap(torch.func.grad(loss))(*stacked, betas)
    for k in range(population):
        alone = torch.func.grad(loss)(stacked[0][k], stacked[1][k], betas[k])
        torch.testing.assert_close(together[k], alone)


class Functional(torch.nn.Module):
    """A table with other logits."""

    def __init__(self, channel, logits):
        super().__init__()
        self.channel, self.values = channel, logits
        self.outcome_space = channel.outcome_space

    def forward(self, condition):
        return torch.func.functional_call(self.channel, {"logits": self.values}, (condition,))

    def forward_all(self):
        return self(torch.arange(len(self.values)))


@pytest.mark.parametrize(
    ("perception", "action", "percepts", "task", "message"),
    [
        (Gaussian, MLP, NUMBER, PredatorPrey, r"needs percepts that can be enumerated, got Box"),
        (Table, Gaussian, Discrete(3), TargetTask, "needs actions that can be enumerated, got Box"),
    ],
)
def test_densities_are_refused(perception, action, percepts, task, message):
    task = (
        task([[1.0], [2.0]], observations="index")
        if task is TargetTask
        else task(observations="index")
    )
    first = perception(task.observation_space, percepts)
    second = action(percepts, task.action_space)
    chain = Chain(task, first, second, ExactMarginals(), 1.0, 1.0)
    with pytest.raises(ValueError, match=rf"Projection {message}.*; use ScoreFunction"):
        Projection().check(chain)


@pytest.mark.parametrize("decay", [-0.1, 1.0, math.nan])
def test_decay_is_checked(decay):
    with pytest.raises(ValueError, match="decay must be at least 0 and less than 1"):
        Projection(decay)
