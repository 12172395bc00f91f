"""Where motions come from: file readers and the synthetic generator."""
