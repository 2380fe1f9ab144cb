"""Configurations that say what nobody can mean."""

import sys
from pathlib import Path

import pytest

from bra.cli import main

DATA = "data:\n  task: PredatorPrey\n"
LAUGHS = "a0: &a0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10)
)


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Runs the command on a configuration, and returns its one line of error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])

    def run(text, *words):
        Path("c.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(SystemExit) as end:
            main(["fit", "--config=c.yaml", *words])
        assert end.value.code == 2
        assert not Path("lightning_logs").exists()
        return capsys.readouterr().err.splitlines()[-1]

    return run


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (f"{DATA}model: {{percepts: 2}}\nmodel:\n", "line 4: the key 'model' is there twice"),
        (f"{DATA}model:\n  percepts: 2\n  percepts: 2\n", "line 5: the key 'percepts' is there"),
        (f"{DATA}model: {{percepts: 2, percepts: 3}}\n", "line 3: the key 'percepts' is there"),
        *(
            (f"{DATA}model: {value}\n", f"line 3: section 'model' must hold keys and values, {got}")
            for value, got in {"5": "got 5", "": "got nothing", "[]": "got a list"}.items()
        ),
        (f"{DATA}trainer: [max_epochs, 3]\n", "line 3: section 'trainer' must hold keys"),
        (f"{DATA}trainer: true\n", "line 3: section 'trainer' must hold keys"),
        (
            "data: {task: {class_path: PredatorPrey, variant: mating}}\n",
            "line 1: variant beside class_path; what a class is given is in init_args",
        ),
        ("data: 5\n", "line 1: section 'data' must hold keys"),
        ("", "c.yaml must hold sections such as"),
        ("# nothing\n", "c.yaml must hold sections such as"),
        (f"{DATA}5: 3\n", "line 3: expected the name of a section, got 5"),
        (f"{DATA}? [a, b]\n: 3\n", "line 3: expected the name of a key, got a list"),
        ("data: {task: Jäger}\n".encode("latin-1"), "cannot read c.yaml: not UTF-8"),
        (DATA.encode("utf-16"), "cannot read c.yaml: not UTF-8"),
        (bytes(range(256)), "cannot read c.yaml: not UTF-8"),
        (f"{DATA}\0", "c.yaml is no YAML: unacceptable character"),
        (f"{DATA}model: *x\n", "line 3, is no YAML: found undefined alias"),
        (f"{DATA}---\n{DATA}", "line 3, is no YAML: but found another document"),
        (LAUGHS, "its aliases stand for more than a configuration holds"),
        (f"{DATA}model: &m {{cooling: *m}}\n", "line 3: its aliases stand for more"),
        (f"{DATA}model: {'[' * 2000}{']' * 2000}\n", "it is nested too deeply"),
        (f"{DATA}modle:\n", "unknown key modle; did you mean model?"),
        (f"{DATA}foo: {{}}\n", "unknown key foo"),
        (f"{DATA}model: {{percpts: null}}\n", "unknown key model.percpts; did you mean"),
        (f"{DATA}model: {{percpts: {{}}}}\n", "unknown key model.percpts; did you mean"),
        *(
            (f"{DATA}{text}\n", f"unknown key {key}")
            for text, key in {
                "  foo: {bar: {}}": "data.foo.bar",
                "model: {foo: {bar: {}}}": "model.foo.bar",
                "model: {cooling: {factor: 2, foo: {}}}": "model.cooling.foo",
                "model: {perception: {class_path: MLP, init_args: {foo: {}}}}": (
                    "model.perception.init_args.foo"
                ),
                "baseline: {foo: {}}": "baseline.foo",
                "trainer: {callbacks: [{class_path: Timer, init_args: {foo: {}}}]}": (
                    "trainer.callbacks.init_args.foo"
                ),
            }.items()
        ),
        (f"{DATA}model: {{percepts: !!python/name:os.system x}}\n", "could not determine a con"),
        (f"{DATA}  batch_size: null\n", "data.batch_size: expected int, got None"),
        (f"{DATA}  workers: null\n", "data.workers: expected int, got None"),
        (f"{DATA}model: {{cooling: {{factor: null}}}}\n", "model.cooling.factor: expected float"),
        (f"{DATA}baseline: {{restarts: null}}\n", "baseline.restarts: expected int, got None"),
        ("data: {task: null}\n", "data.task: expected class path, got None"),
    ],
)
def test_configurations_that_nobody_can_mean(refused, text, line):
    assert line in refused(text)


@pytest.mark.parametrize(
    ("word", "line"),
    [
        (
            "--trainer.max_epoch=3",
            "unknown key trainer.max_epoch; did you mean trainer.max_epochs?",
        ),
        ("--seed=3", "unknown key seed"),
        ("--model.cooling.foo={}", "unknown key model.cooling.foo"),
        ("--model.cooling={foo: {}}", "unknown key model.cooling.foo"),
        ("--model=5", "model: Unable to load config '5'"),
        ("--trainer=[max_epochs, 3]", "trainer: Unable to load config '[max_epochs, 3]'"),
        ("--model={percepts: 2, percepts: 3}", "the key 'percepts' is there twice"),
        ("--model.percepts=2.0", "model.percepts: expected int or class path, got 2.0"),
        ("--model.cooling=3.0", "model.cooling: expected class path, got 3.0"),
        (
            "--trainer.logger=Foo",
            "trainer.logger: expected class path or Iterable or bool, got Foo",
        ),
    ],
)
def test_keys_that_nobody_can_mean(refused, word, line):
    assert line in refused(DATA, word)


def test_what_can_be_meant(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    Path("sizes.yaml").write_text("percepts: 2\n")
    Path("c.yaml").write_text(
        "\ufeffdata: {task: {class_path: TableTask, init_args: {utilities: &u [[1, 0], [0, 1]]}}}\n"
        "model: sizes.yaml\ntrainer: {}\nbaseline: {class_path: BaselineMonitor, init_args: {}}\n"
    )
    main(["baseline", "--config=c.yaml", "--json"])
    assert '"closed"' in capsys.readouterr().out


def test_settings_beside_a_class_on_the_command_line(refused):
    line = refused(DATA, "--model.update_rule={class_path: Projection, decay: 0.5}")
    said = "decay beside class_path; what a class is given is in init_args"
    assert line == f"error: model.update_rule: {said}"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fit"], "data.task is missing; give --config FILE, or --data.task and a class"),
        (["test", "--ckpt_path=last"], "data.task is missing; give --config FILE"),
        (["export"], "ckpt_path is missing; give --ckpt_path and its value"),
        (["export", "--ckpt_path=nope.ckpt"], "ckpt_path: cannot read nope.ckpt: No such file"),
        (["outcomes", "--folder=/dev/null", "--trials=1"], "/dev/null: File exists"),
    ],
)
def test_what_is_missing_is_told_with_a_way_to_give_it(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"error: {said}")
