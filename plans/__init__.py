"""Experimental plans as data: one CSV file of rows and one TOML file of definitions for each plan.

``material_tests`` has the number of material tests as a factor; its 36 rows are all combinations of levels.

``rackl_hanley_2017.csv`` holds the 72 rows of Table B-1, levels as printed.
``rackl_hanley_2017.toml`` holds what the rows refer to: source, factor levels, parameter intervals
and constants (Table 2, section 2.3.4), fixed inputs (Table 1), targets and the published properties
against which ``calstudy plan check`` holds the rows. ``calstudy.plan_file.load_plan`` reads both.
"""
