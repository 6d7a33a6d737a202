"""Recordings: .tlog, ULog and DataFlash, read and written."""
