"""The paper (Liu et al.): its benches, its thermal models, and their comparison."""
