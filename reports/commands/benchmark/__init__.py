"""`poseterior benchmark`: frozen targets, their exact draws, and verdicts on draws of others."""
