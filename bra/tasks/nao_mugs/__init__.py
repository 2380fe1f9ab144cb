"""A NAO robot that sees a mug and lifts it by its handles."""

import gymnasium

from bra.tasks.nao_mugs.camera import Light
from bra.tasks.nao_mugs.mugs import MUGS, Pose
from bra.tasks.nao_mugs.task import NaoMugs

__all__ = ["MUGS", "Light", "NaoMugs", "Pose"]

gymnasium.register(id="bra/NaoMugs-v0", entry_point="bra.tasks.nao_mugs.environment:NaoMugsEnv")
