"""The printed tables that ship with the package."""

from __future__ import annotations

import pytest

from ikgrad.errors import UnknownNameError
from ikgrad.papers.printed import find_row, numbers, read_table


def test_tables_keep_cells_as_printed():
    assert find_row("apps_table3", motion="I-1", quantity="R_1")["theta1_deg"] == "-20.0995"
    assert find_row("apps_table6", algorithm="NR", motion="I-1")["mae_mm"] == "FALSE"


def test_numbers_follow_the_order_of_the_columns():
    assert numbers(read_table("apps_table2")[1], "x_corrected_m", "x_printed_m") == (1.9485, 1.9845)


def test_an_unknown_table_names_the_nearest():
    with pytest.raises(UnknownNameError, match="unknown paper table 'apps_tabel3'; did you mean 'apps_table3'"):
        read_table("apps_tabel3")


def test_a_missing_row_is_named():
    with pytest.raises(UnknownNameError, match="unknown row of table 'apps_table3' 'motion=7-8'"):
        find_row("apps_table3", motion="7-8")
