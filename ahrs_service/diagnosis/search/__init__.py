"""The search for the model that explains the misfit."""
