"""One thing after another gets worse: the paper's method beside ours."""
