"""What may have been left out: candidates, and models of the misfit with them."""
