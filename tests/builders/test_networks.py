import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.damaged import refusing, rewrite
from tests.models import WORLD, tiny_model
from toponav.builders import (
    Networks,
    load_networks,
    make_networks,
    save_networks,
    start_networks,
)
from toponav.config import SettingsError
from toponav.envs import load_engine
from toponav.modules import (
    ConcatComparator,
    DifferenceComparator,
    ResNet18,
    SmallEncoder,
)
from toponav.worlds import WorldSpec

OTHER_WORLD = WorldSpec(view_size=(64, 48), actions=("left", "right"))
VIEWS = torch.randint(0, 256, (3, 60, 80, 3), dtype=torch.uint8)


def tiny_networks(**changes: object) -> Networks:
    return make_networks(tiny_model(**changes), WORLD)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    networks = tiny_networks()
    networks.thresholds = {"tc_threshold": 0.9}
    save_networks(networks, tmp_path / "networks.pt")
    return tmp_path / "networks.pt"


def test_every_choice_of_the_settings_is_made() -> None:
    networks = make_networks(
        tiny_model(comparator="concat", share_encoder=False), WORLD
    )
    assert isinstance(networks.tc.comparator, ConcatComparator)
    assert networks.tc.encoder is not networks.locomotion.encoder
    networks = tiny_networks()
    assert isinstance(networks.tc.comparator, DifferenceComparator)
    assert isinstance(networks.tc.encoder, SmallEncoder)
    assert networks.tc.encoder is networks.locomotion.encoder
    networks = tiny_networks(encoder="resnet18", share_encoder=False)
    assert isinstance(networks.locomotion.encoder, ResNet18)


def test_a_shared_encoder_counts_once() -> None:
    def count(*, shared: bool) -> int:
        networks = tiny_networks(share_encoder=shared)
        return sum(p.numel() for p in networks.modules.parameters())

    encoder = SmallEncoder(16, image_size=WORLD.view_size)
    num_weights = sum(p.numel() for p in encoder.parameters())
    assert count(shared=False) - count(shared=True) == num_weights


@pytest.mark.parametrize("name", ["vizdoom", "dmlab"])
def test_networks_of_another_engine_are_refused(tmp_path: Path, name: str) -> None:
    worlds = {one: load_engine(one).world for one in ("vizdoom", "dmlab")}
    (other,) = {"vizdoom", "dmlab"} - {name}
    save_networks(make_networks(tiny_model(), worlds[name]), tmp_path / "networks.pt")
    # Views and actions are alike: nothing else would tell.
    assert worlds[name].view_size == worlds[other].view_size
    assert load_networks(tmp_path, world=worlds[name]).engine == name
    rule = f"120 x 160 pixels by engine={other} and 6 actions, got .* by engine={name} "
    with pytest.raises(SettingsError, match=f"^networks must name networks .*{rule}"):
        load_networks(tmp_path, world=worlds[other])


def test_networks_that_do_not_say_their_engine_are_taken(tmp_path: Path) -> None:
    save_networks(tiny_networks(), tmp_path / "networks.pt")
    assert load_networks(tmp_path).engine is None
    sized = replace(WORLD, engine="dmlab")
    assert load_networks(tmp_path, world=sized).num_actions == 6


def test_the_package_has_networks_of_vizdoom() -> None:
    world = load_engine("dmlab").world
    with pytest.raises(SettingsError, match=r"by engine=dmlab .* by engine=vizdoom"):
        load_networks("package:maze3", world=world)


@pytest.mark.parametrize("share_encoder", [True, False])
def test_what_was_saved_is_what_is_loaded(tmp_path: Path, share_encoder: bool) -> None:
    networks = tiny_networks(share_encoder=share_encoder)
    networks.tc(VIEWS, VIEWS)  # moves the statistics of batch normalisation
    networks.thresholds = {"tc_threshold": 0.9, "tc_reach": 0.7}
    save_networks(networks, tmp_path / "networks.pt")
    loaded = load_networks(tmp_path)  # the folder will do
    networks.modules.eval()
    assert loaded.model == networks.model
    assert loaded.thresholds == networks.thresholds
    assert not loaded.tc.training
    assert torch.equal(loaded.tc.embed(VIEWS), networks.tc.embed(VIEWS))
    assert torch.equal(
        loaded.locomotion(VIEWS, VIEWS), networks.locomotion(VIEWS, VIEWS)
    )


def test_training_starts_where_an_earlier_one_ended(saved: Path) -> None:
    earlier = load_networks(saved)
    networks = start_networks(tiny_model(), WORLD, str(saved))
    for name, weight in networks.modules.state_dict().items():
        assert torch.equal(weight, earlier.modules.state_dict()[name]), name


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"must name a run with networks.pt, got"):
        load_networks(tmp_path)
    with pytest.raises(SettingsError, match=r"must name a run with none.pt, got"):
        load_networks(tmp_path / "none.pt")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_file_that_was_cut_off_is_refused(saved: Path, share: float) -> None:
    whole = saved.read_bytes()
    saved.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(SettingsError, match=r"networks must .* got the damaged"):
        load_networks(saved)


def test_a_flipped_bit_of_a_weight_is_found(saved: Path) -> None:
    data = bytearray(saved.read_bytes())
    weights = load_networks(saved).locomotion.head.state_dict().values()
    largest = max(weights, key=torch.numel).numpy().tobytes()
    data[data.index(largest) + 1] ^= 1
    saved.write_bytes(data)
    with pytest.raises(SettingsError, match=r"got the damaged .* checksums"):
        load_networks(saved)


def test_weights_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    networks = tiny_networks()
    with torch.no_grad():
        next(networks.locomotion.head.parameters()).fill_(torch.nan)
    save_networks(networks, tmp_path / "networks.pt")
    with pytest.raises(SettingsError, match=r"all finite numbers, got .* in .*weight"):
        load_networks(tmp_path)


def test_a_header_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "networks.pt"
    torch.save({"kind": torch.zeros(2), "version": 1}, path)
    with pytest.raises(SettingsError, match=r"networks must name .* version 1"):
        load_networks(path)


def test_no_code_in_a_file_is_run(tmp_path: Path) -> None:
    path = tmp_path / "networks.pt"
    path.write_bytes(pickle.dumps(Path("/")))
    with pytest.raises(SettingsError, match="got the damaged"):
        load_networks(path)
    torch.save(torch.zeros(2), path)
    with pytest.raises(SettingsError, match=r"file of this package, got .* Tensor"):
        load_networks(path)
    torch.save({"weights": {}}, path)
    with pytest.raises(SettingsError, match=r"networks of version 1, got .* something"):
        load_networks(path)


def test_other_weights_than_the_model_has_are_refused(saved: Path) -> None:
    state = torch.load(saved, weights_only=True)
    state["model"]["embedding_dim"] = 17
    torch.save(state, saved)
    with pytest.raises(SettingsError, match="networks saved with the same"):
        load_networks(saved)


def test_networks_of_another_model_are_refused(saved: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"init_from .* model.comparator=concat, got difference"
    ):
        start_networks(tiny_model(comparator="concat"), WORLD, str(saved))


def test_networks_are_made_for_the_views_and_actions_of_their_world(
    tmp_path: Path,
) -> None:
    networks = make_networks(tiny_model(), OTHER_WORLD)
    views = torch.zeros(3, *OTHER_WORLD.view_size, 3, dtype=torch.uint8)
    assert networks.locomotion(views, views).shape == (3, 2)
    save_networks(networks, tmp_path / "networks.pt")
    loaded = load_networks(tmp_path)
    assert (loaded.view_size, loaded.num_actions) == ((64, 48), 2)


def test_networks_of_another_world_are_refused(saved: Path) -> None:
    sentence = (
        "pretrained must name networks for views of 64 x 48 pixels and 2 actions, "
        "got some for views of 120 x 160 pixels and 6 actions"
    )
    with pytest.raises(SettingsError, match=sentence):
        load_networks(saved, setting="pretrained", world=OTHER_WORLD)


def test_files_that_name_no_world_are_of_the_mazes(saved: Path) -> None:
    state = torch.load(saved, weights_only=True)
    del state["view_size"], state["num_actions"]
    torch.save(state, saved)
    assert load_networks(saved, world=WORLD).view_size == (120, 160)
    with pytest.raises(SettingsError, match="got some for views of 120 x 160 pixels"):
        load_networks(saved, world=OTHER_WORLD)


@pytest.mark.parametrize("name", ["num_actions", "view_size"])
def test_a_damaged_number_is_not_counted_to(saved: Path, name: str) -> None:
    state = torch.load(saved, weights_only=True)
    # Names for so many actions fill the memory before they are compared.
    state[name] = {"num_actions": 10**8, "view_size": [10**30, 160]}[name]
    torch.save(state, saved)
    with refusing("networks must name networks "):
        load_networks(saved)


def test_views_that_the_encoder_cannot_read_are_refused() -> None:
    world = WorldSpec(view_size=(63, 48), actions=("left", "right"))
    with pytest.raises(SettingsError, match=r"model.encoder=small: .* must be even"):
        make_networks(tiny_model(), world)


@pytest.mark.parametrize(
    "value",
    ["x", None, [1], float("nan"), float("inf"), 5.0, -0.1, True, torch.ones(2)],
)
def test_thresholds_that_are_no_similarities_are_refused(
    saved: Path, value: object
) -> None:
    rewrite(saved, lambda state: state["thresholds"].update(tc_threshold=value))
    rule = (
        r"^networks must name networks whose thresholds are numbers in \[0, 1\], got "
    )
    with pytest.raises(
        SettingsError, match=rf"{rule}\S*networks.pt with tc_threshold="
    ):
        load_networks(saved)


@pytest.mark.parametrize("value", [[1], "x", None])
def test_thresholds_without_names_are_refused(saved: Path, value: object) -> None:
    rewrite(saved, lambda state: state.update(thresholds=value))
    with pytest.raises(SettingsError, match=r"^networks must name networks .*networks"):
        load_networks(saved)


@pytest.mark.parametrize("place", ["thresholds", "model", "engine", "view_size"])
def test_settings_that_take_long_to_print_are_refused(saved: Path, place: str) -> None:
    # Each takes two bytes here, and a fraction of a millisecond to be printed.
    value = [torch.ones(9)] * 50_000

    def change(state: dict[str, Any]) -> None:
        part = {"thresholds": "tc_threshold", "model": "encoder"}.get(place)
        if part is None:
            state[place] = [value, 160] if place == "view_size" else value
        else:
            state[place][part] = value

    rewrite(saved, change)
    with refusing("networks must name networks "):
        load_networks(saved, world=WORLD)


#: What stands in the place of the first weights.
OTHER_WEIGHTS: dict[str, Callable[[torch.Tensor], object]] = {
    "sparse": lambda one: one.to_sparse(),
    "meta": lambda one: one.to("meta"),
    "complex": lambda one: one + 0j,
    "double": lambda one: one.double(),
    "whole": lambda one: one.long(),
    "repeated": lambda one: one.flatten()[:1].clone().expand(one.shape),
    "enormous": lambda one: torch.zeros(1).expand(10**6, 10**4),
    "a word": lambda _: "x",
    "short": lambda one: one[:1],
}


@pytest.mark.parametrize("kind", list(OTHER_WEIGHTS))
def test_weights_of_another_kind_are_refused(saved: Path, kind: str) -> None:
    def change(state: dict[str, Any]) -> None:
        name, weight = next(iter(state["weights"].items()))
        state["weights"][name] = OTHER_WEIGHTS[kind](weight)

    rewrite(saved, change)
    # torch has other functions to make the first two, which no run's files name.
    said = "_rebuild" if kind in ("sparse", "meta") else "0.weight"
    with pytest.raises(SettingsError, match=rf"^networks must name .*{said}"):
        load_networks(saved)


@pytest.mark.parametrize(
    ("hidden", "reason"),
    [
        ([40_000, 40_000], "tc.comparator.rest.3.bias is there or is missing"),
        ([1] * 100_000, "62 weights for 100001 hidden layers"),
    ],
)
def test_a_model_larger_than_its_weights_is_never_made(
    saved: Path, hidden: list[int], reason: str
) -> None:
    rewrite(saved, lambda state: state["model"].update(comparator_hidden=hidden))
    with refusing(f"networks must name networks saved with .*{reason}"):
        load_networks(saved)


def test_rounded_weights_are_weights(tmp_path: Path) -> None:
    networks = tiny_networks()
    save_networks(networks, tmp_path / "networks.pt", half=True)
    loaded = load_networks(tmp_path).modules.state_dict()
    for name, weight in networks.modules.state_dict().items():
        assert loaded[name].dtype is weight.dtype
        assert torch.allclose(loaded[name], weight, atol=1e-3), name
