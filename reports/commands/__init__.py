"""The commands, one file each; `reports.cli` imports a file when its command is called."""
