"""What the misfit would be without left-out physics: its noise and likelihood."""
