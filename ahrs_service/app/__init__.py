"""The programs: the only rooms that join links, pipeline and viewer."""
