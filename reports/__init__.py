"""What is shown: the command line, tables, figures and HTML."""
