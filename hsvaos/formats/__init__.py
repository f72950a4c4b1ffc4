"""Readers and writers of files that others define."""
