"""Checkpoints are whole, or they are not there; and who reads one that is not, is told."""

import errno
import os
import sys
import zipfile

import pytest
import torch
from training import fit

from bra import Agent, PredatorPrey
from bra.agent.trainers import WholeFiles
from bra.checkpoints.files import (
    SEAL,
    CheckpointError,
    find_flaw,
    read_checkpoint,
    write_checkpoint,
)
from bra.cli import main

COUNTS = {"updates": 3, "samples": 6, "recipe": {"seed": 0}}
STATE = {
    "bra": COUNTS,
    "state_dict": {"weight": torch.arange(1000.0)},
    "pytorch-lightning_version": "2.6.0",
}


def test_what_is_written_is_read(tmp_path):
    write_checkpoint(STATE, tmp_path / "new" / "a.ckpt")
    found = read_checkpoint(tmp_path / "new" / "a.ckpt")
    assert torch.equal(found["state_dict"]["weight"], STATE["state_dict"]["weight"])
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.ckpt"]


def test_a_truncated_file_is_named_and_so_is_the_last_whole_one(tmp_path):
    old, whole, cut = (tmp_path / f"{name}.ckpt" for name in ("old", "whole", "last"))
    for age, path in enumerate((old, whole, cut)):
        write_checkpoint(STATE, path)
        os.utime(path, (age, age))
    content = cut.read_bytes()
    for length in (0, 1, 100, len(content) // 2, len(content) - 1):
        cut.write_bytes(content[:length])
        with pytest.raises(ValueError, match=f"{cut} is no whole .* last whole one is {whole}$"):
            read_checkpoint(cut)


def test_a_flipped_bit_is_found_wherever_it_is(tmp_path):
    path = tmp_path / "a.ckpt"
    write_checkpoint(STATE, path)
    content = path.read_bytes()
    for place in {*range(0, len(content), 7), *range(len(content) - 100, len(content))}:
        flipped = content[place] ^ 1 << place % 8
        path.write_bytes(content[:place] + bytes([flipped]) + content[place + 1 :])
        try:
            found = read_checkpoint(path)
        except CheckpointError:
            continue
        assert place >= len(content) - SEAL  # the seal itself
        assert torch.equal(found["state_dict"]["weight"], STATE["state_dict"]["weight"])
    path.write_bytes(content + b"more")
    with pytest.raises(CheckpointError):
        read_checkpoint(path)


def test_files_of_others_are_found_damaged_by_the_checksums_of_their_parts(tmp_path):
    path = tmp_path / "a.ckpt"
    torch.save(STATE, path)
    assert find_flaw(path) == ""
    content = path.read_bytes()
    place = content.index(STATE["state_dict"]["weight"].numpy().tobytes())
    path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    with pytest.raises(CheckpointError, match="does not match its checksum"):
        read_checkpoint(path)


def test_a_checkpoint_is_a_zip_file_for_others(tmp_path):
    path = tmp_path / "a.ckpt"
    write_checkpoint(STATE, path)
    assert zipfile.ZipFile(path).testzip() is None
    found = torch.load(path, weights_only=True)
    assert torch.equal(found["state_dict"]["weight"], STATE["state_dict"]["weight"])


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_where_nothing_can_be_written_the_old_file_stays(tmp_path, monkeypatch, code):
    path = tmp_path / "last.ckpt"
    write_checkpoint(STATE, path)
    before = path.read_bytes()

    def full(_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", full)
    line = f"cannot write checkpoint {path}: {os.strerror(code)}; the last whole one is {path}"
    with pytest.raises(OSError, match=line):
        write_checkpoint(STATE, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["last.ckpt"]


def test_every_trainer_of_an_agent_writes_whole_files(tmp_path):
    trainer = fit(Agent(PredatorPrey(), seed=0), tmp_path, max_epochs=1)
    assert isinstance(trainer.strategy.checkpoint_io, WholeFiles)


def test_last_and_best_are_found(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    short = ["--data.task=PredatorPrey", "--data.updates_per_epoch=4", "--baseline=null"]
    short += ["--behaviour=null", "--trainer.enable_progress_bar=false"]
    with pytest.raises(SystemExit):
        main(["fit", *short, "--ckpt_path=last"])
    assert "error: ckpt_path last: there is no last.ckpt" in capsys.readouterr().err
    for epochs in (1, 2, 3):
        main(["fit", *short, f"--trainer.max_epochs={epochs}", *["--ckpt_path=last"][: epochs - 1]])
        assert f"updates                     {4 * epochs} " in capsys.readouterr().out
    main(["test", *short, "--ckpt_path=best"])
    assert "lightning_logs/version_2/checkpoints/epoch=2-step=12.ckpt\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("part", "value", "said"),
    [
        ("perception", {"class_path": "bra.channels.MLP"}, "it holds a class without arguments"),
        ("cooling", {"class_path": 3, "init_args": {}}, "it holds a class without arguments"),
        ("perception", "MLP", "holds no Agent: perception must be a class of kind Channel"),
        ("task", None, "holds no Agent: task must be of class Task, got None"),
        (
            "cooling",
            {"class_path": "bra.Cooling", "init_args": {"speed": 3}},
            "holds no Agent: .*unexpected keyword argument 'speed'",
        ),
    ],
)
def test_recipes_that_make_no_agent_are_refused_in_one_line(tmp_path, part, value, said):
    path = tmp_path / "agent.ckpt"
    fit(Agent(PredatorPrey(), seed=0), tmp_path, max_steps=1).save_checkpoint(path)
    checkpoint = torch.load(path, weights_only=True)
    checkpoint["bra"]["recipe"][part] = value
    torch.save(checkpoint, path)
    with pytest.raises(ValueError, match=said) as caught:
        Agent.load_from_checkpoint(path)
    assert "\n" not in str(caught.value)
