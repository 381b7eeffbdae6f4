"""What is shown as a picture: one file a subject.

    save_figure(hypotheses_figure(result.tree, five), "five.png")

Here are the pictures of one person's posterior and detection; those of studies are in
`comparison`, `coverage`, `misses`, `evaluation` and `bias`.
"""

from reports.figures.depth import depth_figure
from reports.figures.files import read_image, save_figure
from reports.figures.hypotheses import hypotheses_figure, hypothesis_colours
from reports.figures.overlay import overlay_figure

__all__ = [
    "depth_figure",
    "hypotheses_figure",
    "hypothesis_colours",
    "overlay_figure",
    "read_image",
    "save_figure",
]
