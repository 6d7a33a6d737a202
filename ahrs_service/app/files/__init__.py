"""TOML and JSON files: settings, calibrations, twins, truths."""
