"""A task as a table of utilities."""

import os
from collections.abc import Sequence
from typing import Any

from jsonargparse.typing import Path_fr

from bra.checks.arrays import Array
from bra.tasks.csv_tables import read_utilities
from bra.tasks.finite import FiniteTask
from bra.tasks.observations import Code


class TableTask(FiniteTask):
    """A task from a table of utilities: an array, or a CSV file.

    The file's header row names the actions and its first column the states; the cell where they
    meet is free, but says `state` where states or actions are named by numbers. A column `prior` is
    p(ω). Cells are separated by commas, semicolons or tabs; -inf forbids an action in a state:

        state,  stay, flee
        mouse,  3.5,  0.5
        lion,   0,    5

    Args:
        utilities: U(ω, a), (W, A), or the path of a CSV file.
        prior: p(ω), (W,); from the file, or uniform, if None.
        observations: What the agent sees: "onehot", "index", "binary" or "bipolar" codes of the
            state's index, or an array of signals (W, *shape).
        state_names: A name per state; from the file, or s0, s1, …, if None.
        action_names: A name per action; from the file, or a0, a1, …, if None.
        signal_given_state: p(s|ω), (W, S), of a noisy sensor: it shows a state as signal s, of
            which `observations` then are the codes, or an array (S, *shape). None is noiseless.

    Raises:
        ValueError: If the file is empty, ragged or holds something other than numbers and names
            (with file, line and column), or the table, prior, names or observations do not fit
            together.
    """

    def __init__(
        self,
        utilities: Path_fr | Array | str,
        prior: Array | None = None,
        observations: Code | Array = "onehot",
        state_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        signal_given_state: Array | None = None,
    ) -> None:
        if isinstance(utilities, str | os.PathLike) and not os.fspath(utilities).endswith(
            (".npy", ".npz")
        ):
            read = read_utilities(os.fspath(utilities))
            utilities = read.utilities
            prior = read.prior if prior is None else prior
            state_names = read.state_names if state_names is None else state_names
            action_names = read.action_names if action_names is None else action_names
        super().__init__(
            utilities,
            prior,
            observations,
            state_names,
            action_names,
            signal_given_state=signal_given_state,
        )

    def init_arguments(self) -> dict[str, Any]:
        """The table itself rather than the path of a file, which may move or change."""
        given = super().init_arguments()
        if type(self).__init__ is not TableTask.__init__:  # which makes another table of its own
            return given
        return given | {
            "utilities": self.utilities,
            "prior": self.prior,
            "state_names": list(self.state_names),
            "action_names": list(self.action_names),
        }
