"""Pages that turn: a posterior, or the film of a stream, as one HTML file that needs no network.

    write_page(person_page(result, five, image=photo), "hypotheses.html")

Here is what a page holds, as plain numbers and escaped words; `assets` has how it looks and moves,
a few hundred lines of JavaScript without a library. A body is fourteen lines: a library of scenes
would make a page ten times as large, and know nothing of keyboards and printers.
"""
