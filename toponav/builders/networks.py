"""The TC-network and the L-network: made, written and read."""

from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch
from torch import nn

from toponav.builders.checkpoints import load_checkpoint, save_atomically
from toponav.config import ModelConfig, SettingsError
from toponav.modules import (
    ConcatComparator,
    DifferenceComparator,
    LNetwork,
    LocomotionHead,
    ResNet18,
    SmallEncoder,
    TCNetwork,
)

#: The file in a run folder that holds the networks.
NETWORKS_FILE = "networks.pt"
_VERSION = 1


@dataclass
class Networks:
    """The two networks, and what a user of them must know.

    Args:
        tc: scores how close in time two views are.
        locomotion: names the action from one view to another.
        model: the settings from which they were made.
        thresholds: calibrated on random walks: ``tc_threshold`` and ``tc_reach`` of the
            map, ``reward_threshold`` of the reward's memory; empty until then.
    """

    tc: TCNetwork
    locomotion: LNetwork
    model: ModelConfig
    thresholds: dict[str, float] = field(default_factory=dict)

    @property
    def modules(self) -> nn.ModuleDict:
        """Both under one roof, for optimizers, ``train()`` and ``eval()``.

        A shared encoder counts once among the parameters.
        """
        return nn.ModuleDict({"tc": self.tc, "locomotion": self.locomotion})


def make_encoder(config: ModelConfig) -> SmallEncoder | ResNet18:
    """The encoder of views that a configuration names."""
    if config.encoder == "resnet18":
        return ResNet18(config.embedding_dim)
    return SmallEncoder(config.embedding_dim, batch_norm=config.batch_norm)


def make_networks(
    config: ModelConfig, *, device: torch.device | str = "cpu"
) -> Networks:
    """Fresh networks.

    Args:
        config: encoder, comparator and heads.
        device: where the networks go.

    Examples:
        >>> config = ModelConfig(
        ...     encoder="small",
        ...     embedding_dim=32,
        ...     batch_norm=True,
        ...     share_encoder=True,
        ...     comparator="difference",
        ...     projection_dim=16,
        ...     comparator_hidden=[16],
        ...     locomotion_hidden=[16],
        ... )
        >>> networks = make_networks(config)
        >>> networks.tc.encoder is networks.locomotion.encoder
        True
    """
    encoder = make_encoder(config)
    comparator: ConcatComparator | DifferenceComparator
    if config.comparator == "concat":
        comparator = ConcatComparator(
            config.embedding_dim, hidden=config.comparator_hidden
        )
    else:
        comparator = DifferenceComparator(
            config.embedding_dim,
            projection_dim=config.projection_dim,
            hidden=config.comparator_hidden,
        )
    head = LocomotionHead(config.embedding_dim, hidden=config.locomotion_hidden)
    other = encoder if config.share_encoder else make_encoder(config)
    networks = Networks(TCNetwork(encoder, comparator), LNetwork(other, head), config)
    networks.modules.to(device)
    return networks


def start_networks(
    config: ModelConfig, init_from: str | None, *, device: torch.device | str = "cpu"
) -> Networks:
    """Networks to train: fresh ones, or those of an earlier run.

    Args:
        config: encoder, comparator and heads.
        init_from: run folder or file of networks of the same model, if any.
        device: where the networks go.

    Raises:
        SettingsError: as `load_networks`, if ``init_from`` is not usable.
    """
    if init_from is None:
        return make_networks(config, device=device)
    networks = load_networks(
        init_from, setting="init_from", model=config, device=device
    )
    networks.modules.train()
    return networks


def save_networks(networks: Networks, path: Path) -> None:
    """Write networks and thresholds into one file, atomically.

    Args:
        networks: the networks.
        path: the file.
    """
    state: dict[str, object] = {
        "kind": "toponav networks",
        "version": _VERSION,
        "model": asdict(networks.model),
        "weights": networks.modules.state_dict(),
        "thresholds": dict(networks.thresholds),
    }
    save_atomically(state, path)


def load_networks(
    path: Path | str,
    *,
    setting: str = "networks",
    model: ModelConfig | None = None,
    device: torch.device | str = "cpu",
) -> Networks:
    """Read networks that `save_networks` wrote, in ``eval()`` mode.

    Args:
        path: the file, or the run folder that holds it.
        setting: the setting that named it, for the errors.
        model: the model that the networks must be of, if it matters.
        device: where the networks go.

    Raises:
        SettingsError: if the file is missing, damaged, none of ours, of another
            version or of another model.
    """
    path = Path(path)
    file = path / NETWORKS_FILE if path.is_dir() else path
    state = load_checkpoint(file, setting, device=device)
    if state.get("kind") != "toponav networks" or state.get("version") != _VERSION:
        raise SettingsError(
            f"{setting} must name networks of version {_VERSION}, got {file} with "
            f"{state.get('kind', 'something else')} {state.get('version', '')}".rstrip()
        )
    try:
        config = ModelConfig(**state["model"])  # type: ignore[arg-type]
        require_same_model(config, model or config, setting)
        networks = make_networks(config, device=device)
        networks.modules.load_state_dict(state["weights"])  # type: ignore[arg-type]
        networks.thresholds = dict(state["thresholds"])  # type: ignore[call-overload]
    except (KeyError, TypeError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[0]
        raise SettingsError(
            f"{setting} must name networks whose weights fit their model, got {file} "
            f"({reason[:80]})"
        ) from error
    networks.modules.eval()
    return networks


def require_same_model(given: ModelConfig, wanted: ModelConfig, setting: str) -> None:
    """Refuse networks of another model than the run's, naming the first difference.

    Raises:
        SettingsError: if a setting differs.
    """
    for name, value in asdict(wanted).items():
        if (other := getattr(given, name)) != value:
            raise SettingsError(
                f"{setting} must name networks with model.{name}={value}, got {other}"
            )
