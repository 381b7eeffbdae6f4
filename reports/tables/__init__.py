"""What is shown as a table: one file a subject, one kind of table (`sheet.Sheet`).

Here are the tables of one person's posterior; those of studies are in `comparison`, `coverage`,
`evaluation` and `bias`.
"""

import lazy_loader

# Every name stands in `__init__.pyi` and is looked up when first used: what a command does not need
# it does not wait for.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
