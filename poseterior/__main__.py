"""`python -m poseterior` is `poseterior`."""

from poseterior.reports.cli import command

command()
