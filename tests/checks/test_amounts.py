"""One thing is one."""

import pytest
import torch

from bra import Agent, TableTask
from bra.checks.words import amount, shown


@pytest.mark.parametrize(("count", "said"), [(0, "0 steps"), (1, "1 step"), (1000, "1,000 steps")])
def test_one_thing_is_one(count, said):
    assert amount(count, "step") == said


def test_some_words_have_another_plural():
    assert [amount(count, "box", "boxes") for count in (1, 2)] == ["1 box", "2 boxes"]


def test_an_agent_after_its_first_update():
    agent = Agent(TableTask([[0.0, 1.0], [1.0, 0.0]]), seed=0)
    agent.updates += 1
    assert "\n  1 update\n" in repr(agent)


def test_what_was_given_is_shown_in_one_line():
    said = shown(torch.ones(3, 40))
    assert said.startswith("tensor([[1., 1.,") and said.endswith(" …") and len(said) == 62
    assert "\n" not in said and shown("abc") == "'abc'"
