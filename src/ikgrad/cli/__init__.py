"""The command ``ikgrad``: the only layer that prints. One module per command, heavy imports inside its ``run``."""
