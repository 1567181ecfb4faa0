"""Schemas of the job's tables: one class per table, each default once."""
