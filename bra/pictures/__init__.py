"""Pictures by Pillow, with letters of their own, which have the Greek ones too."""

from bra.pictures.heatmap import beside, draw_heatmap
from bra.pictures.letters import legible

__all__ = ["beside", "draw_heatmap", "legible"]
