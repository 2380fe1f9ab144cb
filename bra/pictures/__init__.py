"""Pictures by Pillow, with letters of their own, which have the Greek ones too."""

from bra.pictures.heatmap import draw_heatmap

__all__ = ["draw_heatmap"]
