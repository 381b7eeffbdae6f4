"""Pages that turn: a posterior, or the film of a stream, as one HTML file that needs no network.

    write_page(person_page(result, five, image=photo), "hypotheses.html")

Here is what a page holds, as plain numbers and escaped words; `assets` has how it looks and moves, a
few hundred lines of JavaScript without a library. A library of 3D scenes would take most of the five
megabytes a page may have, where a body is fourteen lines; these turn, enlarge and print by keyboard and
finger alike.
"""
