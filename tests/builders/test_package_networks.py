from pathlib import Path

import pytest
import torch

from tests.composed import settings
from tests.models import WORLD, tiny_model
from toponav.builders import (
    PACKAGE_NETWORKS,
    load_networks,
    make_networks,
    save_networks,
    start_networks,
)
from toponav.config import SettingsError
from toponav.envs import MAZES
from toponav.worlds import WorldSpec

NAMES = [f"package:{maze}" for maze in MAZES]
THRESHOLDS = {"reward_threshold", "tc_reach", "tc_threshold"}
VIEWS = torch.randint(0, 256, (3, 120, 160, 3), dtype=torch.uint8)


@pytest.mark.parametrize("name", NAMES)
def test_every_maze_has_networks_with_thresholds(name: str) -> None:
    networks = load_networks(name, setting="pretrained", world=WORLD)
    assert networks.model == settings("pretrain", "model=tiny").model
    assert set(networks.thresholds) == THRESHOLDS
    assert all(p.dtype == torch.float32 for p in networks.modules.parameters())
    assert networks.tc(VIEWS, VIEWS).isfinite().all()


def test_all_of_them_fit_into_5_megabytes() -> None:
    files = list(PACKAGE_NETWORKS.iterdir())
    assert sorted(file.stem for file in files) == sorted(MAZES)
    assert sum(file.stat().st_size for file in files) <= 5e6


def test_networks_of_different_mazes_differ() -> None:
    embeddings = [load_networks(name).tc.embed(VIEWS) for name in NAMES]
    for index, one in enumerate(embeddings):
        assert all(not torch.allclose(one, other) for other in embeddings[:index])


def test_an_unknown_name_is_refused_with_the_nearest_one() -> None:
    sentence = (
        "pretrained must be one of package:maze1, package:maze2, package:maze3, "
        r"package:select, got 'package:maz3' \(did you mean 'package:maze3'\?\)"
    )
    with pytest.raises(SettingsError, match=sentence):
        load_networks("package:maz3", setting="pretrained")


def test_another_world_or_model_is_refused() -> None:
    world = WorldSpec(view_size=(64, 48), actions=("left", "right"))
    with pytest.raises(SettingsError, match="pretrained must name networks for views"):
        load_networks(NAMES[0], setting="pretrained", world=world)
    with pytest.raises(SettingsError, match=r"init_from .* model.embedding_dim=16"):
        start_networks(tiny_model(), WORLD, NAMES[0])


def test_half_the_precision_is_half_the_file_and_nearly_the_same(
    tmp_path: Path,
) -> None:
    networks = make_networks(tiny_model(), WORLD)
    networks.tc(VIEWS, VIEWS)  # moves the statistics of batch normalisation
    networks.modules.eval()
    save_networks(networks, tmp_path / "whole.pt")
    save_networks(networks, tmp_path / "half.pt", half=True)
    sizes = [(tmp_path / name).stat().st_size for name in ("half.pt", "whole.pt")]
    assert sizes[0] < 0.6 * sizes[1]
    loaded = load_networks(tmp_path / "half.pt")
    assert loaded.tc.encoder is loaded.locomotion.encoder
    assert next(networks.modules.parameters()).dtype == torch.float32
    # float16 has 11 bits.
    torch.testing.assert_close(
        loaded.tc.embed(VIEWS), networks.tc.embed(VIEWS), rtol=1e-2, atol=5e-3
    )
