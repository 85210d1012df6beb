"""Training of the nano model: a stock LLaVA checkpoint from labelled driving scenes."""
