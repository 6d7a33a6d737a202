"""What physics may be missing: candidates, and models of the misfit that contain them."""
