"""Reproductions of published studies: one package per paper, one function per table, results as plain records.

The printed tables are CSV files in ``data/``, as printed unless a column says "corrected"; `ikgrad.papers.printed`
reads them. Nothing here prints; `ikgrad reproduce` does.
"""
