"""Readers of recordings: tables, arrays, bags, datasets."""
