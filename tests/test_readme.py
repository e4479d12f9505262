"""README is true: its code runs, its files exist, its commands are the CI's."""

import re
from pathlib import Path

import gymnasium
import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
CODE = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("code", CODE, ids=["torchrl", "gymnasium"])
def test_its_code_runs(code: str) -> None:
    names: dict[str, object] = {}
    exec(code, names)
    env = names["env"]
    if isinstance(env, gymnasium.Env):
        view, _ = env.reset(seed=0)
        assert view.shape == (120, 160, 3)
        env.close()
    else:
        assert names["rollout"]["pixels"].shape == (8, 100, 120, 160, 3)  # type: ignore[index]


def test_its_links_and_scripts_exist() -> None:
    linked = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    named = re.findall(r"\b((?:recipes|benchmarks)/\w+\.py|install\.sh)", README)
    pictures = re.findall(r'src="([^"]+)"', README)
    assert {"docs/house.md", "recipes/tour.py"} <= {*linked, *named}
    for path in (*linked, *named, *pictures):
        assert (ROOT / path).exists(), path


def test_ci_runs_its_test_command() -> None:
    marked = README.split("<!-- tests -->")[1]
    command = re.search(r"```bash\n(.*?)\n```", marked, re.DOTALL)
    assert command is not None
    words = "bash install.sh && .venv/bin/python -m pytest -n 2 --dist worksteal"
    assert command[1] == words
    assert "<!-- tests -->" in (ROOT / ".ci/run").read_text()
