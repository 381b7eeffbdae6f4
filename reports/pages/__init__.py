"""What writes the pages in reports/: a module for each page, its template beside it.

    python -m poseterior.reports.pages.NAME …

`page` is what all of them share. They are of use in a checkout alone, and not installed.
"""
