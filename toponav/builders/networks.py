"""The TC-network and the L-network: built, saved, loaded and published."""

import copy
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from toponav.builders.processes import has_fast_bf16
from toponav.config import ModelConfig, SettingsError, refusing, require
from toponav.envs import DEFAULT_ENGINE, load_engine, unknown_name
from toponav.modules import (
    ConcatComparator,
    DifferenceComparator,
    LNetwork,
    LocomotionHead,
    ResNet18,
    SmallEncoder,
    TCNetwork,
)
from toponav.runs import (
    reading_checkpoint,
    require_like,
    require_plain,
    save_atomically,
)
from toponav.worlds import WorldSpec

#: The file in a run folder that holds the networks.
NETWORKS_FILE = "networks.pt"
_HEADER = {"kind": "toponav networks", "version": 1}
#: Networks that come with the package: ``package:maze3`` names ``maze3.pt``.
PACKAGE_NETWORKS = Path(__file__).with_name("package_networks")
_PACKAGE = "package:"


@dataclass
class Networks:
    """The two networks, and the views and actions that they were made for."""

    tc: TCNetwork
    locomotion: LNetwork
    model: ModelConfig
    view_size: tuple[int, int]  # height and width
    num_actions: int
    engine: str | None = None  # what drew the views; unknown of earlier versions
    #: Calibrated on random walks, by these weights: ``tc_threshold``, ``tc_reach`` of
    #: the map, ``reward_threshold`` of the reward's memory; empty until then.
    thresholds: dict[str, float] = field(default_factory=dict)

    @property
    def modules(self) -> nn.ModuleDict:
        """Both in one module; a shared encoder counts once among the parameters."""
        return nn.ModuleDict({"tc": self.tc, "locomotion": self.locomotion})

    @property
    def device(self) -> torch.device:
        """Where they compute."""
        return next(self.tc.parameters()).device


def make_encoder(config: ModelConfig, world: WorldSpec) -> SmallEncoder | ResNet18:
    """The encoder that a configuration names, for the views of a world."""
    if config.encoder == "resnet18":
        return ResNet18(config.embedding_dim, image_size=world.view_size)
    return SmallEncoder(
        config.embedding_dim, batch_norm=config.batch_norm, image_size=world.view_size
    )


def make_networks(
    config: ModelConfig, world: WorldSpec, *, device: torch.device | str = "cpu"
) -> Networks:
    """Fresh networks for the views and the actions of a world.

    Raises:
        SettingsError: if the encoder cannot read views of this size.

    Examples:
        >>> config = ModelConfig(
        ...     encoder="small", embedding_dim=32, batch_norm=True, share_encoder=True,
        ...     comparator="difference", projection_dim=16, comparator_hidden=[16],
        ...     locomotion_hidden=[16])
        >>> world = WorldSpec(view_size=(64, 64), actions=("left", "right"))
        >>> networks = make_networks(config, world)
        >>> networks.tc.encoder is networks.locomotion.encoder
        True
    """
    with refusing(f"model.encoder={config.encoder}: "):
        encoder = make_encoder(config, world)
    dim, hidden = config.embedding_dim, config.comparator_hidden
    comparator: ConcatComparator | DifferenceComparator
    if config.comparator == "concat":
        comparator = ConcatComparator(dim, hidden=hidden)
    else:
        comparator = DifferenceComparator(
            dim, projection_dim=config.projection_dim, hidden=hidden
        )
    head = LocomotionHead(
        dim, hidden=config.locomotion_hidden, num_actions=world.num_actions
    )
    other = encoder if config.share_encoder else make_encoder(config, world)
    networks = Networks(
        TCNetwork(encoder, comparator),
        LNetwork(other, head),
        config,
        view_size=world.view_size,
        num_actions=world.num_actions,
        engine=world.engine,
    )
    networks.modules.to(device)
    return networks


def start_networks(
    config: ModelConfig,
    world: WorldSpec,
    init_from: str | None,
    *,
    device: torch.device | str = "cpu",
) -> Networks:
    """Networks to train: fresh ones, or those that ``init_from`` names."""
    if init_from is None:
        return make_networks(config, world, device=device)
    return load_networks(
        init_from, setting="init_from", model=config, world=world, device=device
    )


def save_networks(networks: Networks, path: Path, *, half: bool = False) -> None:
    """Write networks and thresholds into one file, atomically.

    ``half`` rounds the weights to float16, for half the size.
    """
    modules = networks.modules
    if half:
        modules = copy.deepcopy(modules).half()
    state: dict[str, object] = {
        **_HEADER,
        "model": asdict(networks.model),
        "view_size": list(networks.view_size),
        "num_actions": networks.num_actions,
        "engine": networks.engine,
        "weights": modules.state_dict(),
        "thresholds": dict(networks.thresholds),
    }
    save_atomically(state, path)


def networks_path(name: Path | str, setting: str = "networks") -> Path:
    """The path of a file or of the run folder that holds it, or of ``package:<maze>``.

    Raises:
        SettingsError: if the package has no networks of that name.

    Examples:
        >>> networks_path("package:maze3").name
        'maze3.pt'
    """
    if not str(name).startswith(_PACKAGE):
        return Path(name)
    choices = {_PACKAGE + path.stem: path for path in PACKAGE_NETWORKS.glob("*.pt")}
    if name not in choices:
        raise SettingsError(str(unknown_name(setting, str(name), choices)))
    return choices[str(name)]


def load_networks(
    path: Path | str,
    *,
    setting: str = "networks",
    model: ModelConfig | None = None,
    world: WorldSpec | None = None,
    device: torch.device | str = "cpu",
) -> Networks:
    """Read networks that `save_networks` wrote, in ``eval()`` mode.

    ``path`` is what `networks_path` takes, ``setting`` what named it. If ``model`` or
    ``world`` is given, the networks must be of and for that.

    Raises:
        SettingsError: if the file is not usable, or is of another model or world: a
            weight is missing or of another shape or type, or a threshold is no number
            in [0, 1].
    """
    path = networks_path(path, setting)
    file = path / NETWORKS_FILE if path.is_dir() else path
    with reading_checkpoint(file, setting, _HEADER, "networks") as state:
        _require_words(state)
        # Earlier versions knew one engine alone, and did not write its numbers.
        default = load_engine(DEFAULT_ENGINE).world
        height, width = state.get("view_size", default.view_size)
        num_actions = int(state.get("num_actions", default.num_actions))
        weights = state["weights"]
        require_plain(weights)
        # A damaged number may be more than can be counted to.
        most = max(len(one) for one in weights.values() if one.ndim)
        if num_actions > most:
            raise ValueError(f"weights of at most {most} actions, not {num_actions:g}")
        made_for = WorldSpec(
            view_size=(height, width),
            actions=tuple(map(str, range(num_actions))),
            engine=state.get("engine"),
        )
        require_same_world(made_for, world or made_for, setting)
        config = ModelConfig(**state["model"])
        require_same_model(config, model or config, setting)
        _require_weights(weights, config, made_for)
        thresholds = _read_thresholds(state["thresholds"], setting, file)
        networks = make_networks(config, made_for, device=device)
        networks.modules.load_state_dict(weights)
        networks.thresholds = thresholds
    networks.modules.eval()
    return networks


def _require_words(state: Mapping[str, Any]) -> None:
    """Refuse settings that refusals could not print, such as a million tensors.

    Raises:
        ValueError: unless they are words, numbers or lists of those.
    """
    others = ("view_size", "num_actions", "engine")
    given = {**state["model"], **{name: state.get(name) for name in others}}
    for name, value in given.items():
        for one in value if isinstance(value, list | tuple) else [value]:
            if not isinstance(one, str | int | float | None):
                raise ValueError(f"{name} is no word, number or list of them")


def _require_weights(
    weights: Mapping[str, Tensor], config: ModelConfig, world: WorldSpec
) -> None:
    """Refuse others than such networks have, before memory is taken for those.

    Raises:
        ValueError: that names the first that differs.
    """
    # Each layer has a weight, and many layers take long to make even without memory.
    layers = len(config.comparator_hidden) + len(config.locomotion_hidden)
    if layers > len(weights):
        raise ValueError(f"{len(weights)} weights for {layers} hidden layers")
    # There, tensors have shapes and no content.
    with torch.device("meta"):
        fresh = make_networks(config, world, device="meta").modules.state_dict()
    # The package's own are rounded, see `save_networks`.
    require_like(weights, fresh, rounded=True)


def _read_thresholds(
    found: Mapping[str, Any], setting: str, file: Path
) -> dict[str, float]:
    """The thresholds of a file; SettingsError unless they are similarities."""
    for name, value in found.items():
        rule = f"{setting} must name networks whose thresholds are numbers in [0, 1]"
        holds = type(value) in (int, float) and 0 <= value <= 1
        plain = isinstance(value, str | int | float)
        given = str(value)[:40] if plain else type(value).__name__
        require(holds, rule, f"{file} with {name}={given}")
    return dict(found)


def require_same_world(given: WorldSpec, wanted: WorldSpec, setting: str) -> None:
    """Refuse networks of other views, another engine or another number of actions."""
    # Those of earlier versions do not say which engine drew their views.
    known = given.engine is not None and wanted.engine is not None

    def describe(world: WorldSpec) -> str:
        height, width = world.view_size
        by = f" by engine={world.engine}" if known else ""
        views = f"views of {height} x {width} pixels{by}"
        return f"{views} and {world.num_actions} actions"

    rule = f"{setting} must name networks for {describe(wanted)}"
    require(describe(given) == describe(wanted), rule, f"some for {describe(given)}")


def require_same_model(given: ModelConfig, wanted: ModelConfig, setting: str) -> None:
    """Refuse networks of another model than the run's, naming the first difference."""
    for name, value in asdict(wanted).items():
        rule = f"{setting} must name networks with model.{name}={value}"
        require(getattr(given, name) == value, rule, getattr(given, name))


class Novelty(nn.Module):
    """A TC-network and the similarity at which a view counts as known.

    They travel together. Networks that continue training are shared and not copied;
    a calibrated threshold is calibrated again for each version of them.
    """

    threshold: Tensor

    def __init__(self, tc: TCNetwork, threshold: float = 0.5) -> None:
        super().__init__()
        self.tc = tc
        self.register_buffer("threshold", torch.tensor(threshold, dtype=torch.float64))


def make_empty_novelty(model: ModelConfig, world: WorldSpec) -> Novelty:
    """One to be filled with published weights."""
    return Novelty(make_networks(model, world).tc).eval()


def for_inference(novelty: Novelty, model: ModelConfig) -> Novelty:
    """The same in bfloat16, in place, where its device is faster so; not for training.

    On a processor ResNet-18 takes half the time, and the small encoder gains nothing.
    Casting at each call, as autocast does, would take a third of the gain away.
    """
    device = next(novelty.tc.parameters()).device
    if model.encoder == "resnet18" and has_fast_bf16(device):
        novelty.tc.bfloat16()
    return novelty
