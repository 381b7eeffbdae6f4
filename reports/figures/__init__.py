"""What is shown as a picture: one file a subject.

    save_figure(hypotheses_figure(result.tree, five), "five.png")

Here are the pictures of one person's posterior and detection; those of studies are in
`comparison`, `coverage`, `misses`, `evaluation` and `bias`.
"""

import lazy_loader

# Every name stands in `__init__.pyi` and is looked up when first used: what a command does not need
# it does not wait for.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
