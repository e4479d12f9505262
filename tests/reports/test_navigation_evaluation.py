import math

from toponav.reports import markdown_summary


def test_a_table_says_nothing_where_there_is_nothing():
    rows = [{"policy": "oracle", "goals": 2.0, "delay": math.nan}]
    rows.append({"policy": "navigator", "goals": 1.0, "delay": 7.0})
    rows[1] |= {"goals_low": 0.5, "goals_high": 1.5}
    lines = markdown_summary(rows, title="ring").splitlines()
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[2:]]
    assert table[0] == ["", "oracle", "navigator"]
    assert table[2:] == [["goals", "2", "1 (0.5 to 1.5)"], ["delay", "", "7"]]
