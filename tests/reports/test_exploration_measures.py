from pathlib import Path

import pandas as pd

from tests.sweeps import make_exploration
from toponav.reports import kept_return


def test_the_policy_that_is_kept_has_the_higher_return(tmp_path: Path) -> None:
    run = make_exploration(tmp_path, best=[0.5, 0.5])
    table = pd.read_csv(run / "evaluation.csv")
    # Two episodes each; blind ones are never kept.
    returns = {"best": [1.0, 5.0], "last": [4.0, 6.0], "random": [9.0, 9.0]}
    for policy, values in returns.items():
        table.loc[table["policy"] == policy, "intrinsic_return"] = values
    table.to_csv(run / "evaluation.csv", index=False)
    assert kept_return(run) == 5.0  # (4 + 6) / 2, where best has (1 + 5) / 2
