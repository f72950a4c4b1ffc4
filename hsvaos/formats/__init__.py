"""Readers and writers of files that others define; `open_flight` knows them all."""
