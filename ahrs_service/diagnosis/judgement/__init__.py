"""How far a finding can be trusted."""
