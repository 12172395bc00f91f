"""How well it works: the metrics and experiments of the paper, as reports."""
