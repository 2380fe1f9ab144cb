"""Pages of help, and commands that say what is missing."""

import pytest

from bra.channels import MLP
from bra.cli import main
from bra.cli.help import known_classes
from bra.cli.pages import settings, type_text


def page(capsys, *args):
    with pytest.raises(SystemExit) as exit_:
        main([*args, "--help"])
    assert exit_.value.code == 0
    return capsys.readouterr().out


def test_keys_have_types_and_defaults(capsys):
    shown = page(capsys, "fit")
    assert shown.startswith("usage:") and "Trains an agent, or a population" in shown
    assert "--data.batch_size  (int, 64)\n      World-states per update." in shown
    assert "--model.beta_perception  (float or list of float" in shown
    assert "--model.perception  (channel)" in shown and "--data.task  (task)" in shown
    assert "limit_train_batches" in shown and "--trainer.limit_train_batches" not in shown
    assert len(shown.splitlines()) < 150
    assert max(map(len, shown.splitlines())) <= 100


def test_commands_of_a_checkpoint_have_keys_of_their_own(capsys):
    shown = page(capsys, "rollout")
    assert "--episodes  (int, 12)" in shown and "--config" not in shown
    assert "Lightning" not in shown


def test_classes_are_listed_by_kind(capsys):
    main(["help"])
    shown = capsys.readouterr().out
    for name in ("PredatorPrey", "MLP", "Projection", "NetworkCritic", "Cooling", "RunSummary"):
        assert f"  {name} " in shown
    assert "ReduceLROnPlateau" not in shown
    for kind, classes in known_classes().items():
        assert f"{kind}:" in shown and classes


@pytest.mark.parametrize("name", ["rule", "update rule", "update_rules"])
def test_a_kind_has_the_settings_of_all_its_classes(capsys, name):
    main(["help", name])
    shown = capsys.readouterr().out
    assert "ScoreFunction: " in shown
    assert "  baseline: none or running or leave-one-out = none" in shown


def test_a_class_has_its_settings(capsys):
    main(["help", "MLP"])
    shown = capsys.readouterr().out
    assert "  hidden: list of int = (20,)\n      Sizes of the hidden layers" in shown
    assert "condition_space" not in shown
    assert any(entry.startswith("  bias: true or false = true") for entry in settings(MLP))


def test_types_are_told_as_people_say_them():
    assert type_text(int | list[float] | None) == "int or list of float or null"
    assert type_text(bool) == "true or false"


def test_unknown_names_are_told_what_there_is(capsys):
    with pytest.raises(SystemExit):
        main(["help", "MPL"])
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("error: unknown class or kind MPL; did you mean MLP? expected one of")
