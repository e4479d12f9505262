from pathlib import Path

import pytest
from PIL import Image

from toponav.plotting import draw_curves, save_figure


def test_a_picture_that_fails_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "curves.png"
    figure = draw_curves([], panels={"Loss": ["loss"]}, x="update")
    save_figure(figure, path, dpi=50)
    old = path.read_bytes()

    def killed(file: Path, **_: object) -> None:
        Path(file).write_bytes(b"half a picture")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure, "savefig", killed)
    with pytest.raises(KeyboardInterrupt):
        save_figure(figure, path)
    assert path.read_bytes() == old
    assert [file.name for file in tmp_path.iterdir()] == ["curves.png"]
    assert Image.open(path).size[0] == 210
