from .colours import hypothesis_colours as hypothesis_colours
from .depth import depth_figure as depth_figure
from .files import read_image as read_image
from .files import save_figure as save_figure
from .film import film_figure as film_figure
from .hypotheses import hypotheses_figure as hypotheses_figure
from .overlay import overlay_figure as overlay_figure
