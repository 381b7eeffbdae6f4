"""The paper's evaluation, on any data set: many frames under many conditions, errors, tables, and
what holds of them.

`run.evaluate` draws and judges every frame, on one machine or many, and keeps what came out of each
(`run.open_evaluation`); `scores`, `relations` and `bias` are what tables and figures are made
of."""
