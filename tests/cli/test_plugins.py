"""Classes of packages that are installed beside bra."""

import sys

import pytest

from bra.cli import main


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Installs a package whose module has such a text."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])

    def install(text):
        (tmp_path / "bets_of_a_test.py").write_text(text)
        info = tmp_path / "bra_bets-0.1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bra-bets\nVersion: 0.1\n")
        (info / "entry_points.txt").write_text("[bra.plugins]\nbets = bets_of_a_test\n")

    yield install
    sys.modules.pop("bets_of_a_test", None)


BETS = """import bra

class BetOfATest(bra.FiniteTask):
    \"""Heads or tails.\"""

    def __init__(self, stake: float = 1.0):
        super().__init__([[stake, -stake], [-stake, stake]])
"""


def test_every_command_knows_them(plugin, capsys):
    plugin(BETS)
    main(["help"])
    assert "BetOfATest" in capsys.readouterr().out
    main(["help", "BetOfATest"])
    assert "stake: float = 1.0" in capsys.readouterr().out
    quiet = ["--trainer.enable_progress_bar=false", "--trainer.max_epochs=1", "--behaviour=null"]
    main(["fit", "--data.task=BetOfATest", "--data.updates_per_epoch=2", *quiet])
    main(["export", "--ckpt_path=lightning_logs/version_0/checkpoints/last.ckpt"])
    assert "action_marginal.csv" in capsys.readouterr().out


def test_one_that_is_broken_is_named(plugin, capsys):
    plugin("import what_nobody_has")
    with pytest.raises(SystemExit):
        main(["help"])
    line = capsys.readouterr().err.splitlines()[-1]
    assert line == (
        "error: plugin bets of bra-bets cannot be imported: ModuleNotFoundError: No module named "
        "'what_nobody_has'; mend or uninstall it"
    )
