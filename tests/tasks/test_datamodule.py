"""The stream of worlds: counted, not carried."""

import math
import multiprocessing
import os
from types import SimpleNamespace

import pytest
import torch

from bra.tasks import PredatorPrey, RolloutDataModule, TableTask, World, WorldError
from bra.tasks.datamodule import WorldStream


def trainer(updates=0, done_in_epoch=0, seed=0, rank=0, devices=1):
    module = SimpleNamespace(seed=seed, updates=updates)
    current = SimpleNamespace(ready=done_in_epoch)
    epoch_loop = SimpleNamespace(batch_progress=SimpleNamespace(current=current))
    return SimpleNamespace(
        num_training_batches=math.inf,
        current_epoch=0,
        lightning_module=module,
        global_rank=rank,
        world_size=devices,
        fit_loop=SimpleNamespace(epoch_loop=epoch_loop),
    )


def stream(batch_size=6, updates_per_epoch=5, workers=0, **position):
    module = RolloutDataModule(PredatorPrey(), batch_size, updates_per_epoch, workers)
    module.trainer = trainer(**position)
    return list(module.train_dataloader())


def same(left, right):
    return len(left) == len(right) and all(
        torch.equal(a.state, b.state) and torch.equal(a.observation, b.observation)
        for a, b in zip(left, right, strict=True)
    )


def test_an_epoch_is_a_number_of_batches():
    batches = stream(batch_size=6, updates_per_epoch=5)
    assert [batch.state.shape for batch in batches] == [(6,)] * 5
    assert all(batch.observation.shape == (6, 4) for batch in batches)
    task = PredatorPrey()
    assert all(torch.equal(batch.observation, task.observations[batch.state]) for batch in batches)


# Every worker imports torch and Lightning afresh, which takes seconds.
@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_the_stream_is_the_same_for_any_number_of_workers(workers):
    assert same(stream(updates_per_epoch=3), stream(updates_per_epoch=3, workers=workers))


def test_the_stream_is_a_function_of_seed_and_update():
    # Two batches of 64 are equal by chance with probability 9⁻⁶⁴.
    torch.manual_seed(0)
    first = stream(batch_size=64)
    torch.manual_seed(1)
    assert same(first, stream(batch_size=64))
    other_seed = stream(batch_size=64, seed=1)
    batches = [tuple(batch.state.tolist()) for batch in first + other_seed]
    assert len(set(batches)) == 10


def test_the_stream_goes_on_where_the_agent_stands():
    whole = stream(updates_per_epoch=5) + stream(updates_per_epoch=5, updates=5)
    assert same(whole, stream(updates_per_epoch=10))
    assert same(whole[7:], stream(updates_per_epoch=5, updates=7, done_in_epoch=2))
    assert same(whole[4:9], stream(updates_per_epoch=5, updates=4))


def test_one_loader_follows_the_agent():
    module = RolloutDataModule(PredatorPrey(), batch_size=4, updates_per_epoch=5)
    module.trainer = trainer()
    loader = module.train_dataloader()
    assert len(loader) == 5
    first = list(loader)
    module.trainer.lightning_module.updates = 5
    second = list(loader)
    module.trainer.lightning_module.updates = 8
    module.trainer.fit_loop.epoch_loop.batch_progress.current.ready = 3
    third = list(loader)
    assert same(first + second, stream(batch_size=4, updates_per_epoch=10))
    assert same(third, second[3:])


def test_without_an_agent_the_finished_epochs_count():
    module = RolloutDataModule(PredatorPrey(), batch_size=6, updates_per_epoch=5)
    assert same(list(module.train_dataloader()), stream())
    module.trainer = trainer()
    module.trainer.lightning_module = object()
    module.trainer.current_epoch = 2
    assert same(list(module.train_dataloader()), stream(updates=10))


def test_every_device_gets_the_whole_batch():
    assert same(stream(), stream(rank=1, devices=2))


class OneByOne(PredatorPrey):
    """A task with its own way to draw, which knows of no streams."""

    def sample(self, count, generator):
        state = torch.randint(9, (count,), generator=generator)
        return World(state, self.observations[state])


@pytest.mark.parametrize("task", [PredatorPrey(), OneByOne()], ids=["together", "one by one"])
def test_several_streams_are_each_what_it_is_alone(task):
    together = WorldStream(task, 5, [3, 1, 4], "world")
    for update in (0, 1, 63, 64, 10**6, 2):
        world = together[update]
        for index, seed in enumerate((3, 1, 4)):
            alone = WorldStream(task, 5, seed, "world")[update]
            assert same([World(*(part[index] for part in world))], [alone])


def test_worlds_may_be_changed_by_those_who_get_them():
    stream = WorldStream(PredatorPrey(), 3, [0, 1], "world")
    kept = [part.clone() for part in stream[5]]
    for part in stream[5]:
        part.zero_()
    for before, after in zip(kept, stream[5], strict=True):
        assert before.any() and torch.equal(before, after)


def test_signals_may_be_empty():
    stream = WorldStream(TableTask(torch.eye(2), None, torch.zeros(2, 0)), 3, [0, 1], "world")
    assert stream[0].observation.shape == (2, 3, 0)


def test_states_come_as_often_as_the_prior_says():
    # Of 10 000 draws of probability p, the number is more than 5 deviations off with probability
    # 6e-7. The seed is fixed.
    prior = torch.tensor([0.0, 0.5, 0.2, 0.0, 0.3, 0.0], dtype=torch.double)
    task = TableTask(torch.eye(6), prior)
    counts = WorldStream(task, 10_000, 0, "world")[0].state.bincount(minlength=6)
    assert (counts[prior == 0] == 0).all()
    expected = 10_000 * prior
    assert ((counts - expected).abs() <= 5 * (expected * (1 - prior)).sqrt()).all()


def test_held_back_worlds_are_others_and_stay_the_same():
    module = RolloutDataModule(PredatorPrey(), batch_size=32, evaluation_worlds=32)
    module.trainer = trainer()
    loaders = (module.val_dataloader, module.test_dataloader, module.predict_dataloader)
    batches = [list(loader()) for loader in loaders]
    assert [len(batch) for batch in batches] == [1, 1, 1]
    module.trainer.lightning_module.updates = 7
    assert all(same(list(loader()), batch) for loader, batch in zip(loaders, batches, strict=True))
    trained = next(iter(stream(batch_size=32)))
    # Equal by chance with probability 9⁻³².
    states = {tuple(world.state.tolist()) for world in (trained, *(batch[0] for batch in batches))}
    assert len(states) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"batch_size": 0}, "batch_size must be a whole number of at least 1, got 0"),
        ({"batch_size": 2.5}, "batch_size must be a whole number of at least 1, got 2.5"),
        ({"batch_size": True}, "batch_size must be a whole number of at least 1, got True"),
        ({"updates_per_epoch": -1}, "updates_per_epoch must be .* at least 1, got -1"),
        ({"evaluation_worlds": 0}, "evaluation_worlds must be .* at least 1, got 0"),
        ({"workers": -1}, "workers must be a whole number of at least 0, got -1"),
        ({"workers": 1.5}, "workers must be a whole number of at least 0, got 1.5"),
        ({"workers": None}, "workers must be a whole number of at least 0, got None"),
        ({"workers": 10**6}, "workers 1,000,000 would take more than"),
    ],
)
def test_bad_sizes_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        RolloutDataModule(TableTask([[0.0, 1.0]]), **arguments)


class Fails(TableTask):
    """Draws two batches, then fails in one of two ways."""

    def __init__(self, dies: bool) -> None:
        super().__init__(torch.eye(2))
        self.dies = dies
        self.drawn = 0

    def sample(self, count, generator):
        self.drawn += 1
        if self.drawn > 2 and self.dies:
            os._exit(1)
        if self.drawn > 2:
            raise WorldError("the camera shows nothing")
        return super().sample(count, generator)


@pytest.mark.parametrize("workers", [0, 1])
def test_a_world_that_fails_says_so_in_one_line(workers):
    batches = iter(RolloutDataModule(Fails(dies=False), workers=workers).train_dataloader())
    next(batches), next(batches)
    with pytest.raises(WorldError) as caught:
        next(batches)
    assert str(caught.value) == "the camera shows nothing"


def test_a_worker_that_dies_between_two_epochs():
    others = multiprocessing.active_children()
    batches = RolloutDataModule(PredatorPrey(), updates_per_epoch=2, workers=1).train_dataloader()
    list(batches)
    (worker,) = set(multiprocessing.active_children()) - set(others)
    worker.kill()
    worker.join()
    with pytest.raises(WorldError, match=r"worlds was killed by signal 9 \(SIGKILL\); .* if mem"):
        list(batches)


def test_a_worker_that_dies_stops_the_stream():
    batches = RolloutDataModule(Fails(dies=True), workers=1).train_dataloader()
    with pytest.raises(WorldError, match=r"a process that draws worlds ended with exit code 1$"):
        list(batches)
